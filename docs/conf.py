"""Site of bayesterra's documentation: ``sphinx-build -W docs build/site``."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "bayesterra"
author = "The bayesterra developers"
version = release = version_of("bayesterra")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "command_help",
    "docstrings",
    "mathml",
    "study_keys",
    "study_pages",
    "symbols",
]
exclude_patterns = ["_build", "extensions"]
templates_path: list[str] = []

myst_enable_extensions = ["amsmath", "attrs_inline", "deflist", "dollarmath", "colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "force"  # a notebook whose outputs are not those of this version would be a copy by hand
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_in_temp = True

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 100
python_use_unqualified_type_names = True
default_role = "code"
nitpicky = False

html_theme = "furo"
html_title = f"bayesterra {version}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_copyright = False
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": False}
