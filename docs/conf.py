# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Sphinx: the site of this folder, made by ``make docs`` into out/docs."""

import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import generate

from valve_control import __version__

project = "valve_control"
author = "valve_control developers"
copyright = author
release = version = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
source_suffix = {".md": "markdown"}
root_doc = "index"
exclude_patterns = ["examples", "generated"]
default_role = "code"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "undoc-members": False}
html_theme = "furo"
html_title = f"valve_control {__version__}"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["wide.css"]
html_copy_source = False
# Code blocks are of a shell, of its output, or of a page that the reader's own tools highlight.
suppress_warnings = ["misc.highlighting_failure"]


def math(translator: Any, node: nodes.Node, display: str) -> None:
    """Write one equation as MathML, which browsers draw by themselves."""
    text = convert(node.astext(), display=display)
    translator.body.append(text if display == "inline" else f'<div class="math">{text}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Generate the reference before each build."""
    app.connect("builder-inited", lambda app: generate.write(HERE / "reference" / "generated"))
    app.connect("autodoc-process-docstring", generate.as_rst)
    app.connect("autodoc-skip-member", generate.skipped)
    app.add_html_math_renderer(
        "mathml",
        (lambda t, n: math(t, n, "inline"), None),
        (lambda t, n: math(t, n, "block"), None),
    )
