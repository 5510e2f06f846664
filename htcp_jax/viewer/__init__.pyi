from . import movie, offscreen, replay, strip, timed_play
from .arm_picture import draw_arm
from .browser import Viewer
from .needles import needles
from .picture import draw_cell, draw_plan
from .render import Studio

__all__ = [
    "Studio",
    "Viewer",
    "draw_arm",
    "draw_cell",
    "draw_plan",
    "movie",
    "needles",
    "offscreen",
    "replay",
    "strip",
    "timed_play",
]
