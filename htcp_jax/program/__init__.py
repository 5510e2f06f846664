"""Programs: a motion with time, within the arm's limits, and clear all along as timed."""
