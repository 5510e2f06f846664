"""The exceptions and notes that a user can cause."""


class InputError(ValueError):
    """Bad input. The message is one line that names the offender and the valid choices; the command line
    prints it and exits with 2."""


class Note(UserWarning):
    """Something that was assumed, and that the user may want to know. The command line prints it in one line."""


class Interrupted(Exception):
    """A signal ended the work. The message says what was kept; `code` is the command's exit code."""

    def __init__(self, message: str, signal: int):
        super().__init__(message)
        self.code = 128 + signal


class Lost(Exception):
    """The machines that did the work are gone. The message says what was kept."""
