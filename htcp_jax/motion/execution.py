"""`Execution`: the devices, threads and processes that plan a problem."""

from dataclasses import dataclass

from htcp_jax.errors import InputError


@dataclass(frozen=True)
class Execution:
    """Devices, threads and processes that plan a problem. Results depend on none of them but the kind of device.

    Attributes:
        device: `cpu`, `gpu` or `gpu:2`; None: all GPUs if there are any, else the CPU.
        threads: Number of engines per process; None: one, or one per core if there is only one process.
        processes: Number of processes that share the scenarios on a CPU; None: see `processes.profitable_count`. Work
            that other processes cannot import, for example a method or an obstacle defined in a notebook, is planned
            in this one.
        targets_in_all: Number of targets of all problems that belong together, such as the shards of a sweep; None: of
            this problem. It determines whether several processes are used.
        warm_up: Names of methods that will plan such scenarios. Their executables are compiled before the plan, in
            parallel, see `Method.warm_up`.

    Raises:
        InputError: For fewer than one process.
    """

    device: str | None = None
    threads: int | None = None
    processes: int | None = None
    targets_in_all: int | None = None
    warm_up: tuple[str, ...] = ()

    def __post_init__(self):
        if self.processes is not None and self.processes < 1:
            raise InputError(f"processes is {self.processes}; it must be 1 or more")


DEFAULT = Execution()
