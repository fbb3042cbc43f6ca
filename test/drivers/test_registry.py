# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Drivers of other packages: entry points as pip leaves them, sound and broken."""

import os
import shutil
import subprocess
import sys
import textwrap

import pytest
from examples import EXAMPLES

from valve_control.control.drivers import registry
from valve_control.control.drivers.driver import DriverError
from valve_control.parameter import defaults

SOUND = """
from valve_control.control.drivers.driver import Kind
from valve_control.parameter import Parameter
KIND = Kind("card", "a card", (Parameter("card.port", "", "", "port"),), lambda values, period, off: None)
FOREIGN = KIND._replace(name="rack")
CAPITAL = KIND._replace(name="Card", parameters=())
TAKEN = KIND._replace(name="simulated", parameters=())
NONE = 3
"""


def listed(folder, points):
    """Names of the kinds and what is said of those left out, with the entry ``points`` installed."""
    (folder / "card_driver.py").write_text(SOUND)
    info = folder / "card_driver-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: card_driver\nVersion: 1.0\n")
    lines = [f"{name} = card_driver:{attribute}" for name, attribute in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[valve_control.drivers]", *lines]))
    code = """
        from valve_control.control.drivers.registry import BUILT_IN, KINDS, LEFT_OUT
        print({name: kind.package for name, kind in KINDS.items() if kind not in BUILT_IN})
        print(*LEFT_OUT.values(), sep="\\n")
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True, text=True, timeout=60, env={**os.environ, "PYTHONPATH": f"{folder}:."},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_broken_ones_are_left_out_with_the_reason(tmp_path):
    broken = ("NONE", "FOREIGN", "CAPITAL", "TAKEN", "ABSENT", "KIND", "KIND")
    kinds, *said = listed(tmp_path, dict(zip("abcdefg", broken, strict=True)))
    assert kinds == "{'card': 'card_driver'}" and len(said) == 6
    for sentence, words in zip(
        said,
        ["it is 3; it must be", "card.port must begin with 'rack.'",
         "'Card'; it must be one word in lower case",
         "the name is taken by a driver of valve_control", "left out: AttributeError",
         "the name is taken by a driver of card_driver"],
        strict=True,
    ):  # fmt: skip
        assert "of the package card_driver is left out: " in sentence and words in sentence


@pytest.mark.parametrize("name", ["canopen", "modbus", "serial"])
def test_a_driver_without_its_library_says_how_to_install_it(monkeypatch, name):
    monkeypatch.setitem(sys.modules, {"modbus": "pymodbus.client"}.get(name, name), None)
    monkeypatch.delitem(sys.modules, "valve_control.control.drivers.can_bus", raising=False)
    kind = registry.KINDS[name]
    with pytest.raises(DriverError, match=rf"pip install 'valve_control\[{name}\]'"):
        kind.make(defaults(kind.parameters), 0.01, 0.0).open()


def test_the_example_of_the_docs_drives_files_of_counts(tmp_path):
    """Half of full scale in both directions, 0 V at beginning and end, and a card without numbers."""
    code = """
        import sys, pathlib
        from valve_control.control.drivers.driver import DriverError
        from valve_control.control.drivers.registry import KINDS
        from valve_control.parameter import defaults, updated
        from valve_control.control.parameters import drivers
        folder = pathlib.Path(sys.argv[1])
        (folder / "in_voltage0_raw").write_text("16384")
        values = updated(
            drivers.VALVE_DRIVER, defaults(drivers.VALVE_DRIVER), {"driver": "iio", "iio.folder": str(folder)}
        )
        one = drivers.device(values)
        one.open()
        assert not (folder / "out_voltage0_raw").exists()
        one.enable(True)
        one.write(-5.0)
        print(one.read().signal, (folder / "out_voltage0_raw").read_text().strip())
        one.close()
        print((folder / "out_voltage0_raw").read_text().strip(), KINDS["iio"].package)
        (folder / "in_voltage0_raw").write_text("busy")
        try:
            drivers.device(values).open()
        except DriverError as error:
            print(error)
    """
    folder = tmp_path / "site"
    shutil.copytree(EXAMPLES / "iio_card", folder)
    info = folder / "valve_iio_card-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: valve_iio_card\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[valve_control.drivers]\niio = iio_card:KIND")
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), str(tmp_path)],
        capture_output=True, text=True, timeout=60, env={"PYTHONPATH": f"{folder}:."},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:2] == ["5.0 -16384", "0 valve_iio_card"]
    assert "gives no number" in lines[2]
