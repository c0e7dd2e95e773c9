"""Sphinx configuration: Markdown pages, and the API reference from the docstrings."""

from importlib.metadata import version as installed_version

project = "camctl"
copyright = "the camctl authors"
release = version = installed_version("camctl")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinxcontrib.mermaid",
]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"camctl {version}"

# Single backticks in docstrings are names: a link where the name is documented, else code.
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_preserve_defaults = True
napoleon_use_ivar = True

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
myst_fence_as_directive = ["mermaid"]
