"""A driver to be killed: `run_standins.py FOLDER WORKERS COUNT SLEEP`."""

import sys
from pathlib import Path

import standins

from hyjax.sweep.engine import Engine
from hyjax.sweep.task import Task

if __name__ == "__main__":
    folder, workers, count, sleep = Path(sys.argv[1]), *map(float, sys.argv[2:])
    tasks = [Task({"number": number, "sleep": sleep}) for number in range(int(count))]
    with Engine.open(int(workers), None, folder) as engine:
        print(sum(1 for _ in engine.run(standins.double, tasks)))
