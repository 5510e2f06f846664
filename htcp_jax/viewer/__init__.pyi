from . import movie, offscreen, plot_strip, reach_picture
from .arm_picture import draw_arm
from .browser.page import Viewer
from .file_motion import replays_of_file
from .normal_glyphs import glyphs
from .picture import draw_cell, draw_plan
from .reach_picture import ReachPanel, draw_reach
from .render import Studio
from .replay import Replay, Replays, recorded_replays, replays_of
from .timed_play import arms_of, frame_times, sample_program

__all__ = [
    "ReachPanel",
    "Replay",
    "Replays",
    "Studio",
    "Viewer",
    "arms_of",
    "draw_arm",
    "draw_cell",
    "draw_plan",
    "draw_reach",
    "frame_times",
    "glyphs",
    "movie",
    "offscreen",
    "plot_strip",
    "reach_picture",
    "recorded_replays",
    "replays_of",
    "replays_of_file",
    "sample_program",
]
