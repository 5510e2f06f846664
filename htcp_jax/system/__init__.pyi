from . import files, lock, output_files, process_exit, unfinished
from .files import (
    LARGEST,
    known_ending,
    note_missing_line_end,
    one_line,
    open_named,
    opened,
    quiet,
    read_bytes,
    read_inside,
    read_tail,
)
from .lock import SignalReceived, locked, signals
from .process_exit import INTERRUPTED, is_watched, run, stop_message
from .unfinished import NO_LINK, PART, READ, clear, lock_file, temporary_folder

__all__ = [
    "INTERRUPTED",
    "LARGEST",
    "NO_LINK",
    "PART",
    "READ",
    "SignalReceived",
    "clear",
    "files",
    "is_watched",
    "known_ending",
    "lock",
    "lock_file",
    "locked",
    "note_missing_line_end",
    "one_line",
    "open_named",
    "opened",
    "output_files",
    "process_exit",
    "quiet",
    "read_bytes",
    "read_inside",
    "read_tail",
    "run",
    "signals",
    "stop_message",
    "temporary_folder",
    "unfinished",
]
