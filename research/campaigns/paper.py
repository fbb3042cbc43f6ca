# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs what `python -m research.paper` needs through the real nodes, in lockstep over DDS."""

import sys
from pathlib import Path

from research.campaigns.lockstep import check, heard_enough, run_lockstep
from research.campaigns.processes import parse_tool, run_tool, tool_options
from research.paper import traces
from research.paper.runs import CONFIG, paper_runs, valve_of
from valve_control import outputs
from valve_control.control.parameters import ros_file

TRIES = 3


def main() -> int:
    """Write a trace of each run; exit status 1 if one differs from its twin offline."""
    options = tool_options("paper", __doc__, ())
    options.add_argument(
        "--config", default=str(ros_file.config_folder() / CONFIG), metavar="FILE", help="the valve"
    )
    arguments = parse_tool(options)
    folder = Path(arguments.out)

    def work() -> int:
        config = str(Path(arguments.config).resolve())
        valve = valve_of(config)
        results = []
        for run in paper_runs(valve):
            for _ in range(TRIES):
                heard = run_lockstep(run.name, [config], run.settings, folder)
                if heard_enough(heard.result):
                    break
                print(f"{run.name}: too few messages heard on a busy machine, once more", file=sys.stderr)
            results.append(heard.result)
            trace = traces.heard(heard.twin, heard.samples["spool_position"], heard.samples["valve_voltage"])
            traces.save(folder / f"{run.name}.npz", trace)
        path = folder / "lockstep.json"
        outputs.write(str(path), outputs.as_json(results))
        return 0 if check(results) else 1

    return run_tool("paper", folder, work)


if __name__ == "__main__":
    sys.exit(main())
