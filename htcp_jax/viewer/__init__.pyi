from . import movie, offscreen, plot_strip, reach_picture, replay, timed_play
from .arm_picture import draw_arm
from .browser.page import Viewer
from .normal_glyphs import glyphs
from .picture import draw_cell, draw_plan
from .reach_picture import ReachPanel, draw_reach
from .render import Studio

__all__ = [
    "ReachPanel",
    "Studio",
    "Viewer",
    "draw_arm",
    "draw_cell",
    "draw_plan",
    "draw_reach",
    "glyphs",
    "movie",
    "offscreen",
    "plot_strip",
    "reach_picture",
    "replay",
    "timed_play",
]
