"""Sphinx configuration: furo, MyST notebooks that are executed, numpydoc docstrings."""

import os
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "smfe"
author = "The smfe developers"
copyright = "2026, The smfe developers"
release = version = installed_version("smfe")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml", "offline", "tutorials"]
html_math_renderer = "mathml"
# One page alone, for whoever writes it: `make page PAGE=hammer`.
page = os.environ.get("SMFE_PAGE")
include_patterns = [f"{page}.md", "index.md"] if page else ["**"]
exclude_patterns = ["_build", "_made", "*_table.md", "**.ipynb_checkpoints"]

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["smfe.css"]
html_title = f"smfe {release}"

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

# Figures of examples stand on the page: a backend that the caller has set for tests would swallow them.
os.environ.pop("MPLBACKEND", None)

# Every example runs at every build, and one that fails, fails the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True

# The public names of a package are those of its facade, in the order in which it lists them.
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 88
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
