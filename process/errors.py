"""What "the input is wrong" and "the result must be read with care" are called."""


class InputError(ValueError):
    """Input that cannot be used.

    The message states the input, the requirement and the remedy. The command line prints it
    without a traceback and ends with exit code 1.
    """


class SmfeWarning(UserWarning):
    """What somebody must know who uses a result: said once a call, and kept with the result.

    Parameters
    ----------
    sentences : str
        Each thing to know, as one sentence.
    """

    def __init__(self, *sentences: str) -> None:
        super().__init__("\n".join(sentences))
        self.sentences = sentences
