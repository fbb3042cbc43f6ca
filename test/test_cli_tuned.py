"""compare --tuned as a user runs it."""

import json

import pytest


def test_tuned_laws_beside_the_oracle(run, tmp_path):
    status, out, err = run("compare", "--tuned", "--valves", "2", "--json", "t.json", "--figure", "t.png")
    assert status == 0, err
    assert "medians over 2 valves of the narrow box" in out and "wrote t.png" in out
    result = json.loads((tmp_path / "t.json").read_text())
    assert result["valves"] == 2 and result["laws"]["pid_plain"]["preview_s"] > 0.0
    for mode in ("with preview", "command alone"):
        assert {"pid_plain", "pid_reference", "oarc", "dcarc", "oracle"} == result[mode].keys()
        for told in result[mode].values():
            assert len(told["median"]) == 5 and told["c_u"] > 0.0
    assert (tmp_path / "t.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--tuned", "--valves", "0"], "--valves is 0; it must lie between 1 and 100000"),
        (["--tuned", "--seed", "-1"], "--seed is -1; it must be 0 or more"),
        (["--tuned", "--limit", "0.123"], "no gains are tuned for the narrow box at c_u <= 0.123"),
        (["--tuned", "--gains", "nowhere"], "nowhere has none"),
        (["--tuned", "--box", "huge"], "invalid choice"),
        (["--tuned", "--duration", "3"], "compare --tuned takes no --duration"),
        (["--tuned", "some_bag"], "compare --tuned takes no bags"),
        (["--tuned", "--figure", "t.pdf"], ".png or .svg"),
        (["--box", "wide"], "compare takes --box with --tuned only"),
    ],
)
def test_bad_input_of_compare_tuned_is_one_sentence(run, tmp_path, arguments, words):
    status, out, err = run("compare", *arguments)
    assert status == 2 and out == ""
    assert len(err.strip().splitlines()) == 1 and words in err, err
    assert list(tmp_path.iterdir()) == []
