"""Sphinx configuration: Markdown pages, and the API reference from the docstrings."""

import re
from importlib.metadata import version as installed_version

from docutils.nodes import Element, TextElement
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

project = "camctl"
copyright = "the camctl authors"
release = version = installed_version("camctl")

extensions = [
    "myst_nb",  # Markdown pages, and notebooks
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
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

nb_execution_mode = "off"  # they hold what they show; see run_notebooks.py
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3


def resolve_public_name(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, text: TextElement
) -> Element | None:
    """Link camctl.interface.camera.Frame, as a hint names it, to its public name camctl.Frame."""
    target = re.sub(r"^camctl\.[a-z_.]+\.(?=[A-Za-z]\w*)", "camctl.", node.get("reftarget", ""))
    if node.get("refdomain") != "py" or target.split(".")[1:2] == []:
        return None
    domain = env.get_domain("py")
    return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", target, node, text)


def setup(app: Sphinx) -> None:
    """Register the link resolver."""
    app.connect("missing-reference", resolve_public_name)
