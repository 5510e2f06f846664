"""Joint paths between tracked targets that a method did not check itself, checked after it has planned."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from htcp_jax.planner.kernels import CHECK_PATH
from htcp_jax.planner.lane_inputs import lane_inputs
from htcp_jax.planner.lanes import gather
from htcp_jax.planner.plans import Plans
from htcp_jax.planner.problem import Problem
from htcp_jax.planner.tip_check import tip_checks


def check_remaining_paths(problem: Problem, plans: Plans) -> None:
    """Fill in path_clear where a tracked target's path was not checked while planning."""
    s, t = np.nonzero(plans.tracked & (plans.path_clear < 0))
    if not len(s):
        return
    before, inputs = plans.before(s, t), lane_inputs(problem.scenarios, s, t)
    kernels = problem.kernels  # made here, before there are threads
    tips = tip_checks(kernels, problem.tip_guard)

    def check(number: int) -> None:
        part = np.arange(len(s))[number :: problem.threads]
        pick = gather((inputs, before, plans.x[s, t]), part)
        if len(part):
            own = number % len(kernels)
            clear = kernels[own](CHECK_PATH, *pick)
            plans.path_clear[s[part], t[part]] = clear if tips[own] is None else clear & ~tips[own].along(*pick)

    with ThreadPoolExecutor(problem.threads) as pool:
        list(pool.map(check, range(problem.threads)))
