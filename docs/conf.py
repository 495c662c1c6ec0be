"""How Sphinx builds the site: ``sphinx-build -W -n docs out/docs``; nothing is fetched, now or later."""

import sys
from pathlib import Path

import nlosoptics

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "nlosoptics"
author = "The nlosoptics developers"
copyright = "The nlosoptics developers, BSD-3-Clause"  # noqa: A001
version = release = nlosoptics.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "mathml",
    "references",
]
exclude_patterns = ["_generated", "_templates", "figures"]
templates_path = ["_templates"]
nitpicky = True
suppress_warnings = ["config.cache"]  # the gallery's scraper is a function, which has no pickle

# Prose is Markdown; docstrings are numpydoc.
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
default_role = "py:obj"
autosummary_generate = True
autosummary_ignore_module_all = False
autosummary_imported_members = True
autodoc_typehints = "none"
autodoc_member_order = "groupwise"
numpydoc_show_class_members = False
numpydoc_xref_param_type = True

html_theme = "pydata_sphinx_theme"
html_title = "nlosoptics"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["nlosoptics.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "show_prev_next": False,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": []}
