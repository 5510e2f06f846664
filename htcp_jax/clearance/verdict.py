"""When a configuration counts: clear by at least the margin asked for, and on its target.

Everything that accepts or refuses a configuration asks here, on the host and on the device alike.
"""


def counts(clearance, residual, margin_m, tolerance_m):
    """Whether D > 0 and D >= margin_m [m], and the TCP error residual <= tolerance_m [m]; elementwise, numpy or JAX.

    A margin of 0 asks for D > 0, as the paper does: touching is not clear.
    """
    return (clearance > 0) & (clearance >= margin_m) & (residual <= tolerance_m)
