"""The one exception a user can cause."""


class InputError(ValueError):
    """Bad input. The message is one line that names the offender and the valid choices; the command line
    prints it and exits with 2."""
