# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""FMUs of law and valve: valid for fmpy, and their co-simulation equals the offline run to the last bit."""

import platform
import shutil
import zipfile

import numpy as np
import pytest

from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.simulation import offline
from valve_control.parameter import defaults, updated

fmpy = pytest.importorskip("fmpy")
from fmpy.validation import validate_fmu  # noqa: E402

pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None or platform.machine() != "x86_64", reason="no C compiler, or no x86-64"
)
EXAMPLE = {
    "friction.coulomb": 1.16,
    "friction.static_ratio": 1.25,
    "friction.presliding": 0.0033,
    "lvdt.noise": 0.0056,
    "lvdt.resolution": 0.0037,
    "lvdt.delay": 0.0013,
}
SOLENOID = {
    "valve": "solenoid",
    "solenoid.hysteresis": 0.2,
    "solenoid.dead_time": 0.0007,
    "solenoid.bits": 12,
    "friction.coulomb": 0.3,
    "friction.presliding": 0.02,
    "lvdt.noise": 0.0056,
}
N = 1000
COMMAND = np.where(np.arange(N) < 500, 3.0, -1.5 + np.sin(0.05 * np.arange(N)))


class Slave:
    """One FMU of either version, with its variables by name."""

    def __init__(self, path, folder):
        description = fmpy.read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.two = description.fmiVersion == "2.0"
        self.fmu = fmpy.instantiate_fmu(fmpy.extract(str(path), str(folder)), description, "CoSimulation")
        if self.two:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, **values):
        references = [self.references[name] for name in values]
        (self.fmu.setReal if self.two else self.fmu.setFloat64)(references, list(values.values()))

    def get(self, name):
        return (self.fmu.getReal if self.two else self.fmu.getFloat64)([self.references[name]])[0]

    def step(self, time, step=0.001):
        self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=step)

    def end(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


@pytest.fixture
def exported(run, tmp_path):
    def make(version, *options):
        path = tmp_path / f"{options[1]}_{version}.fmu"
        status, _, err = run("export", *options, "--fmu", version, "--output", path)
        assert status == 0, err
        return path

    return make


PLANTS = {"valve": "measurement"}
FEW = [(2, "arc"), (3, "pid"), (3, "valve")]
OTHERS = [(v, name) for v in (2, 3) for name in (*LAWS, *PLANTS) if (v, name) not in FEW]


@pytest.mark.parametrize(
    ("version", "name"), [*FEW, *(pytest.param(*one, marks=pytest.mark.campaign) for one in OTHERS)]
)
def test_fmpy_finds_nothing_wrong_and_simulates_it(exported, version, name):
    path = exported(version, "--plant" if name in PLANTS else "--controller", name)
    assert validate_fmu(str(path)) == []
    names = zipfile.ZipFile(path).namelist()
    assert {f"sources/{name}.c", f"sources/{name}.h", f"sources/fmi{version}.c", "sources/fmi.h"} <= set(
        names
    )
    result = fmpy.simulate_fmu(str(path), stop_time=0.1, output_interval=0.001)
    output = PLANTS.get(name, "voltage")
    assert len(result) == 101 and np.all(np.isfinite(result[output]))


@pytest.mark.parametrize(
    ("version", "name", "valve"), [(2, "oarc", EXAMPLE), (3, "dcarc", EXAMPLE), (3, "oarc", SOLENOID)]
)
def test_law_and_valve_together_equal_the_offline_run_to_the_last_bit(
    exported, tmp_path, version, name, valve
):
    """At 1 kHz; each sample the law steps first, and the valve then gets its voltage."""
    law = Slave(exported(version, "--controller", name), tmp_path / "law")
    options = [word for parameter, value in valve.items() for word in ("--set", f"{parameter}={value}")]
    plant = Slave(exported(version, "--plant", "valve", *options), tmp_path / "valve")
    values = updated(VALVE, defaults(VALVE), valve)
    wanted = offline.simulate(
        updated(CONTROLLER, defaults(CONTROLLER), {"controller": name}), values, COMMAND, compiled=False
    )
    noise = np.random.default_rng(values["seed"]).standard_normal(N)
    readings, voltages = np.zeros(N), np.zeros(N)
    for k in range(N):
        plant.set(noise=noise[k])
        readings[k] = plant.get("measurement")
        law.set(command=COMMAND[k], measurement=readings[k])
        law.step(k * 0.001)
        voltages[k] = law.get("voltage")
        plant.set(voltage=voltages[k])
        plant.step(k * 0.001)
    law.end()
    plant.end()
    assert np.max(np.abs(voltages)) == 10.0  # it saturates
    assert np.array_equal(readings, wanted.measurement) and np.array_equal(voltages, wanted.voltage)


STEPS = [0.0015, 0.0005, 0.00025, 0.0042, 0.001, 0.0031]


@pytest.mark.parametrize("version", [2, 3])
def test_a_step_of_any_length_has_the_samples_that_begin_in_it(exported, tmp_path, version):
    """As the description says: a valve under a constant voltage is then where whole periods bring it."""
    path = exported(version, "--plant", "valve")
    description = fmpy.read_model_description(str(path))
    assert description.coSimulation.canHandleVariableCommunicationStepSize
    whole, varied = (Slave(path, tmp_path / name) for name in ("whole", "varied"))
    for slave in (whole, varied):
        slave.set(voltage=1.0)
    positions = [whole.get("measurement")]
    for k in range(60):
        whole.step(k * 0.001)
        positions.append(whole.get("measurement"))
    time = 0.0
    for step in STEPS * 5:
        varied.step(time, step)
        time += step
        assert varied.get("measurement") == positions[int(np.ceil(time / 0.001 - 1e-6))], time
    whole.end()
    varied.end()
