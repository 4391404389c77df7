"""The one exception that means "the input is wrong"."""


class InputError(ValueError):
    """Input that cannot be used.

    The message states the input, the requirement and the remedy. The command line prints it
    without a traceback and ends with exit code 1.
    """
