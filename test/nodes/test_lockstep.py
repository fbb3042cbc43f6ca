"""Through real processes over DDS, sample by sample, bit for bit as offline."""

from bench import run_tool


def test_20_s_of_motion_equal_offline_for_every_controller(tmp_path):
    entries = run_tool("lockstep", tmp_path, "--duration", "20")
    assert [e["controller"] for e in entries] == ["arc", "oarc", "pid", "compensator", "open_loop"]
    for entry in entries:
        assert entry["equal"] and entry["samples"] == 20000
        assert entry["voltage_at_end_V"] == entry["offline_voltage_at_end_V"]
        assert entry["times_real_time"] > 1.0
