# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Layouts for PlotJuggler and Foxglove name our topics. Neither program was opened."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

from valve_control.control.laws.registry import LAWS

LAYOUTS = Path(__file__).resolve().parents[2] / "config" / "layouts"
# Of the terms those that each law has, so that the layouts show something whatever the law is.
TOPICS = {"/spool_command", "/spool_position", "/valve_voltage"}
TERMS = set.intersection(*(set(law.term_labels) for law in LAWS.values()))
TOPICS |= {f"/controller/terms/{name}" for name in TERMS}


def test_plotjuggler_subscribes_to_the_topics_of_its_curves():
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    # One attribute with semicolons; entries of their own would be read as no topic at all.
    topics = root.find("Plugins/plugin/selected_topics")
    assert len(topics) == 0 and set(topics.get("value").split(";")) == TOPICS
    assert {curve.get("name") for curve in root.iter("curve")} == {f"{topic}/data" for topic in TOPICS}


def test_foxglove_draws_our_topics():
    panels = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))["configById"]
    paths = [path for name, config in panels.items() if name.startswith("Plot!") for path in config["paths"]]
    assert {path["value"] for path in paths} == {f"{topic}.data" for topic in TOPICS}
