"""How `make docs` builds the documentation."""

from __future__ import annotations

import sys
import warnings
from importlib.metadata import version as version_of
from pathlib import Path
from typing import TYPE_CHECKING

from cornercase import NoticeWarning

if TYPE_CHECKING:
    from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

# What examples say of elements without effect is no news on each page.
warnings.simplefilter("ignore", NoticeWarning)

project = "cornercase"
author = "the authors of cornercase"
version = release = version_of("cornercase")

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "scripts", "**/*.ipynb"]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
# Links to files that are no pages lead to the repository's.
myst_url_schemes = ("http", "https", "mailto")

templates_path = ["_templates"]
autosummary_generate = True
autodoc_typehints = "none"
numpydoc_show_class_members = False

sphinx_gallery_conf = {
    "examples_dirs": "scripts",
    "gallery_dirs": "gallery",
    "within_subsection_order": "FileNameSortKey",
    "filename_pattern": "/plot_",
    "abort_on_example_error": True,
    "show_memory": False,
    "show_signature": False,
    "remove_config_comments": True,
}

html_theme = "pydata_sphinx_theme"
html_title = "cornercase"
html_theme_options = {"show_toc_level": 2, "navigation_with_keys": False, "show_prev_next": True}
html_show_sourcelink = False


def setup(app: Sphinx) -> None:
    """Write the pages that are made from the program before any page is read."""
    from generated_pages import write_commands, write_names, write_options

    write_commands(HERE / "reference" / "commands.md")
    write_options(HERE / "reference" / "options.md")
    write_names(HERE / "reference" / "api.rst", HERE / "reference" / "api")
