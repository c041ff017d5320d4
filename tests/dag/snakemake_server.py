"""Snakemake, loaded once for many commands: what `python -m snakemake` does, each in a child of its
own, without the second that loading it takes.

Only libraries are loaded before a child begins, never the project's own modules: every child
imports those that its PYTHONPATH names, as they are then.
"""

import json
import os
import runpy
import subprocess
import sys
import traceback
from pathlib import Path

LOADED = ("snakemake.cli", "snakemake.workflow", "pydantic", "yaml", "numpy", "PIL.Image", "cv2")


class Server:
    """A process that has loaded Snakemake, and forks for every command. Ends with the block.

    folder: where it may write what the commands say.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.out, self.err = folder / "stdout", folder / "stderr"

    def __enter__(self) -> "Server":
        pipe = subprocess.PIPE
        words = [sys.executable, "-P", str(Path(__file__).resolve())]
        self.process = subprocess.Popen(words, cwd=self.folder, stdin=pipe, stdout=pipe, text=True)
        return self

    def __exit__(self, *_) -> None:
        self.process.stdin.close()
        self.process.wait()

    def run(self, arguments: list[str], cwd: Path, env: dict) -> subprocess.CompletedProcess:
        """Run `snakemake arguments` to its end."""
        places = {"out": str(self.out), "err": str(self.err), "cwd": str(cwd)}
        order = {"arguments": arguments, "env": dict(env)} | places
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()
        status = int(self.process.stdout.readline())
        said = self.out.read_text(), self.err.read_text()
        return subprocess.CompletedProcess(arguments, status, *said)


def serve() -> None:
    """A command for every line of the standard input, and its exit status for each."""
    for name in LOADED:
        __import__(name)
    for line in sys.stdin:
        order = json.loads(line)
        child = os.fork()
        if child == 0:
            become(order)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def become(order: dict) -> None:
    """In the child: be the command. Does not return."""
    status = 1
    try:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for number, place in ((1, order["out"]), (2, order["err"])):
            os.dup2(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        os.chdir(order["cwd"])
        os.environ.clear()
        os.environ.update(order["env"])
        sys.path[:0] = [order["cwd"], *order["env"]["PYTHONPATH"].split(os.pathsep)]
        sys.argv = ["snakemake", *order["arguments"]]
        runpy.run_module("snakemake", run_name="__main__", alter_sys=True)
        status = 0
    except SystemExit as leave:
        status = leave.code if isinstance(leave.code, int) else int(leave.code is not None)
        if isinstance(leave.code, str):
            print(leave.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    serve()
