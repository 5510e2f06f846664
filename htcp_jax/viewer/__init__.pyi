from . import movie, offscreen, plot_strip, reach_picture, seam_marks
from .angle_strip import draw_angles
from .arm_picture import draw_arm
from .browser.page import Viewer
from .file_motion import replays_of_file
from .normal_glyphs import glyphs
from .picture import draw_cell, draw_clearance, draw_plan
from .reach_picture import ReachPanel, draw_reach
from .render import Studio
from .replay import PlannedJob, Replay, Replays, recorded_replays, replays_of
from .timed_play import Curves, arms_of, frame_times, reached_s, sample_program

__all__ = [
    "Curves",
    "PlannedJob",
    "ReachPanel",
    "Replay",
    "Replays",
    "Studio",
    "Viewer",
    "arms_of",
    "draw_angles",
    "draw_arm",
    "draw_cell",
    "draw_clearance",
    "draw_plan",
    "draw_reach",
    "frame_times",
    "glyphs",
    "movie",
    "offscreen",
    "plot_strip",
    "reach_picture",
    "reached_s",
    "recorded_replays",
    "replays_of",
    "replays_of_file",
    "sample_program",
    "seam_marks",
]
