"""The version of the package that is installed."""

import importlib.metadata

__version__ = importlib.metadata.version("smfe")
