"""How Sphinx builds the site, which fetches nothing: ``sphinx-build -W -n docs out/docs``."""

import sys
from pathlib import Path

import pyvista
from pyvista.plotting.utilities.sphinx_gallery import Scraper

import nlosoptics

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "nlosoptics"
author = "The nlosoptics developers"
copyright = "The nlosoptics developers, BSD-3-Clause"
version = release = nlosoptics.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "mathml",
    "references",
    "generated",
    "outputs",
    "thumbnails",
]
exclude_patterns = ["_generated", "_templates", "figures"]
templates_path = ["_templates"]
nitpicky = True

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

# The gallery is every examples/plot_*.py; three-dimensional pictures are drawn off-screen.
pyvista.BUILDING_GALLERY = True
pyvista.OFF_SCREEN = True
sphinx_gallery_conf = {
    "examples_dirs": "_generated/scripts",
    "gallery_dirs": "gallery",
    "backreferences_dir": "_generated/uses",  # which script uses which function
    "doc_module": ("nlosoptics",),
    "reset_modules": ("matplotlib", "generated.name_script"),
    "image_scrapers": ("thumbnails.scrape", Scraper()),
    "download_all_examples": False,
    "write_computation_times": False,
    "show_signature": False,
    "remove_config_comments": True,
    "ignore_repr_types": "matplotlib",  # what the last line of a block returns
}

html_theme = "pydata_sphinx_theme"
html_title = f"nlosoptics {version}"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["nlosoptics.css"]
html_js_files = ["accessible.js"]
html_context = {"default_mode": "auto"}
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "header_links_before_dropdown": 7,
    "show_prev_next": True,
    "navigation_with_keys": False,
    # pages of the gallery are short, and their figures need the width
    "secondary_sidebar_items": {"gallery/*": [], "[!g]**": ["page-toc"]},
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
# pages without pages below them
alone = ("index", "live", "tutorial", "validation", "performance", "limits", "changelog")
html_sidebars: dict[str, list[str]] = {page: [] for page in (*alone, "gallery/plot_*")}
