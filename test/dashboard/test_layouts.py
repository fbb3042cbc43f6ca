# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Layouts for PlotJuggler and Foxglove: what these programs read of them is there, and names our topics.

What they read stands in their sources: PlotJuggler 3.17 (plot_docker.cpp, plotwidget.cpp), its plugins for
ROS 2.3 (parser_configuration.cpp), and Lichtblick 1.10, the open successor of Foxglove Studio
(panels/Plot/utils/config.ts, CurrentLayoutContext/actions.ts). Names that they do not know they pass over
without a word. Neither program was opened.
"""

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from valve_control.control.laws.law import FIELDS

LAYOUTS = Path(__file__).resolve().parents[2] / "config" / "layouts"
# Of the terms those that each law has, so that the layouts show something whatever the law is.
TOPICS = {"/spool_command", "/spool_position", "/valve_voltage"}
TOPICS |= {f"/controller/terms/{name}" for name in FIELDS["Terms"]}
COLOUR = re.compile(r"#[0-9a-f]{6}")
PLOT = {
    "paths", "showLegend", "legendDisplay", "showPlotValuesInLegend", "showXAxisLabels", "showYAxisLabels",
    "isSynced", "xAxisVal", "sidebarDimension",
}  # fmt: skip
MAY = {"foxglovePanelTitle", "followingViewWidth", "minYValue", "maxYValue", "minXValue", "maxXValue"}
PATH = {"value", "enabled", "timestampMethod"}


@pytest.fixture(scope="module")
def juggler():
    return ET.parse(LAYOUTS / "plotjuggler.xml").getroot()


@pytest.fixture(scope="module")
def foxglove():
    return json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))


def test_plotjuggler_finds_its_plots(juggler):
    assert juggler.tag == "root"
    (window,) = juggler.findall("tabbed_widget")
    assert window.get("parent") == "main_window" and window.get("name") == "Main Window"
    tabs = window.findall("Tab")
    assert 0 <= int(window.find("currentTabIndex").get("index")) < len(tabs)
    for tab in tabs:
        assert int(tab.get("containers")) == len(tab.findall("Container"))
    splitters = list(juggler.iter("DockSplitter"))
    assert splitters
    for splitter in splitters:
        parts = list(splitter)
        assert splitter.get("orientation") in ("-", "|")
        assert {part.tag for part in parts} <= {"DockArea", "DockSplitter"}
        sizes = [float(size) for size in splitter.get("sizes").split(";")]
        assert int(splitter.get("count")) == len(sizes) == len(parts)
        assert sum(sizes) == pytest.approx(1.0)
    for area in juggler.iter("DockArea"):
        plot = area.find("plot")
        assert plot.get("mode") == "TimeSeries" and plot.get("style") in ("Lines", "LinesAndDots", "Steps")
        assert all(plot.find("range").get(end) is not None for end in ("left", "right", "top", "bottom"))
        assert plot.findall("curve") and all(COLOUR.fullmatch(c.get("color")) for c in plot.findall("curve"))


def test_plotjuggler_subscribes_to_the_topics_of_its_curves(juggler):
    (plugin,) = juggler.find("Plugins")
    assert plugin.tag == "plugin" and plugin.get("ID") == "ROS2 Topic Subscriber"
    assert juggler.find("previouslyLoaded_Streamer").get("name") == plugin.get("ID")
    # One attribute with semicolons; entries of their own would be read as no topic at all.
    topics = plugin.find("selected_topics")
    assert len(topics) == 0 and set(topics.get("value").split(";")) == TOPICS
    switches = ("use_header_stamp", "discard_large_arrays", "boolean_strings_to_number")
    for name in (*switches, "remove_suffix_from_strings"):
        assert plugin.find(name).get("value") in ("true", "false")
    assert int(plugin.find("max_array_size").get("value")) > 0
    curves = [curve.get("name") for curve in juggler.iter("curve")]
    assert {curve.removesuffix("/data") for curve in curves} == TOPICS
    assert all(curve.endswith("/data") for curve in curves)


def panels_of(tree):
    """Panels of Foxglove's mosaic, each side of a split in turn."""
    if isinstance(tree, str):
        return [tree]
    assert set(tree) <= {"direction", "first", "second", "splitPercentage"}
    assert tree["direction"] in ("row", "column") and 0 < tree.get("splitPercentage", 50) < 100
    return [*panels_of(tree["first"]), *panels_of(tree["second"])]


def test_foxglove_finds_its_panels(foxglove):
    assert set(foxglove) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert sorted(panels_of(foxglove["layout"])) == sorted(foxglove["configById"])
    assert {name.partition("!")[0] for name in foxglove["configById"]} == {"Plot", "DiagnosticSummary"}
    summary = next(c for name, c in foxglove["configById"].items() if name.startswith("DiagnosticSummary"))
    assert set(summary) == {"minLevel", "pinnedIds", "hardwareIdFilter", "topicToRender", "sortByLevel"}
    assert summary["topicToRender"] == "/diagnostics" and summary["minLevel"] == 0


def test_foxglove_draws_our_topics(foxglove):
    seen = set()
    for name, config in foxglove["configById"].items():
        if not name.startswith("Plot!"):
            continue
        assert set(config) >= PLOT and set(config) <= PLOT | MAY, name
        assert config["legendDisplay"] in ("floating", "top", "left", "none")
        assert config["xAxisVal"] == "timestamp" and config["foxglovePanelTitle"]
        for path in config["paths"]:
            assert set(path) >= PATH and set(path) <= PATH | {"label", "color", "showLine", "lineSize"}
            assert path["timestampMethod"] in ("receiveTime", "headerStamp")
            assert COLOUR.fullmatch(path["color"]) and path["enabled"] is True
            assert path["value"].endswith(".data")
            seen.add(path["value"].removesuffix(".data"))
    assert seen == TOPICS
