"""The numbers by which validation judges."""

ROUNDING_M = 1e-9  # two ways to compute a clearance differ by 1e-15; 0 and the tolerance are meant to this width
RECORD_M = 1e-5  # a record further off is refuted; 32-bit planners are within it
STEP_RAD = 0.002  # a joint turns no further between two looks; a point 2 m away moves by 4 mm
