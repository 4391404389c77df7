"""The one exception that means "the input is wrong"."""


class InputError(ValueError):
    """Input that cannot be used.

    The message says what was given, what is needed and what to do about it. The command line prints it
    without a traceback and ends with exit code 1.
    """
