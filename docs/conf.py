"""How `make docs` builds the documentation."""

from __future__ import annotations

import os
import sys
import warnings
from importlib.metadata import version as version_of
from pathlib import Path
from typing import TYPE_CHECKING, Any

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

# Where the sources are, as OWNER/NAME on GitHub, which says it to its jobs. Without it, pages link to no repository.
repository = os.environ.get("GITHUB_REPOSITORY", "")
# Pages that are made, and so have no source to edit.
MADE = ("reference/commands", "reference/options", "reference/api", "gallery/", "genindex", "search")

html_theme = "pydata_sphinx_theme"
html_title = f"cornercase {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_favicon = "_static/logo.svg"
html_search_scorer = str(HERE / "search_scorer.js")
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "logo": {
        "text": f"cornercase {release}",
        "alt_text": "cornercase",
        "image_light": "_static/logo.svg",
        "image_dark": "_static/logo-dark.svg",
    },
    "use_edit_page_button": bool(repository),
}
if repository:
    html_theme_options["github_url"] = f"https://github.com/{repository}"
    owner, _, name = repository.partition("/")
    html_context = {"github_user": owner, "github_repo": name, "github_version": "main", "doc_path": "docs"}
html_show_sourcelink = False


def hide_edit_link(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: object) -> None:
    """Show no link that edits a page which is made."""
    if pagename.startswith(MADE):
        context["theme_use_edit_page_button"] = False


def setup(app: Sphinx) -> None:
    """Write the pages that are made from the program before any page is read."""
    from generated_pages import add_registration, write_commands, write_names, write_options

    write_commands(HERE / "reference" / "commands.md")
    write_options(HERE / "reference" / "options.md")
    write_names(HERE / "reference" / "api.rst", HERE / "reference" / "api")
    # Before numpydoc reads the sections.
    app.connect("autodoc-process-docstring", add_registration, priority=400)
    # After the theme's own.
    app.connect("html-page-context", hide_edit_link, priority=900)
