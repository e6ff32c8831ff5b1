"""The site: `make docs` builds it from these pages, from docstrings and from schemas, without the internet.

The source folder is the whole checkout, so that links between pages are the same here, in the checkout and on a forge.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

from eal_actors import __version__  # noqa: E402  # found by the line before

project = "EAL actors"
release = version = __version__
root_doc = "docs/index"
include_patterns = [
    "docs/*.md",
    "docs/*/*.md",
    "plugins/*/README.md",
    "README.md",
    "DESIGN.md",
    "CHANGELOG.md",
    "SECURITY.md",
    "CONTRIBUTING.md",
]
exclude_patterns = ["**/__pycache__", ".nox", ".venv", "build"]
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "_site.docstrings",
    "_site.schemas",
    "_site.commands",
]

myst_heading_anchors = 4
smartquotes_action = "De"  # quotes stay as they are written
suppress_warnings = [
    "misc.highlighting_failure",  # grammars of wire protocols are in no language that Pygments knows
    "toc.not_included",  # a page that stands in no list yet is built and can be linked to
]

copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True  # a block with prompts also shows what they print

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 100
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_include_init_with_doc = False

html_theme = "furo"
html_title = f"EAL actors {release}"
html_logo = html_favicon = "../eal_actors/operate/dashboard/static/icon.svg"
FONT = 'Inter, system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif'
html_theme_options = {  # the colours of the dashboard
    "light_css_variables": {"font-stack": FONT, "color-brand-primary": "#1b5fa8", "color-brand-content": "#1b5fa8"},
    "dark_css_variables": {"color-brand-primary": "#79b8f2", "color-brand-content": "#79b8f2"},
}
html_static_path = ["_site/static"]
html_css_files = ["site.css"]
html_extra_path = ["_site/root"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
pygments_style = "tango"
pygments_dark_style = "github-dark"
