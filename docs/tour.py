#!/usr/bin/env python3
"""Runs the commands of docs/tour.md and puts what they print into the blocks below them: docs/tour.py, after ./run has built everything.

A block belongs to the indented command above it. Where it ends in a line "…" as many lines of the new output are kept as it had."""
import pathlib
import re
import shutil
import subprocess
import sys

root = pathlib.Path(__file__).resolve().parent.parent
tour = root / "docs" / "tour.md"
shutil.rmtree(root / "sessions" / "tour", ignore_errors=True)


def output_of(command):
    print(command, file=sys.stderr)
    done = subprocess.run(["build/release/lacquer", "-q"] + command.split()[1:], cwd=root, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{command}: {done.stderr}")
    return done.stdout.replace(str(root), ".").rstrip("\n").split("\n")


def renewed(match):
    lines, old = output_of(match["command"]), match["block"].rstrip("\n").split("\n")
    if old[-1] == "…":
        lines = lines[: len(old) - 1] + ["…"]
    return f"    {match['command']}\n\n```\n" + "\n".join(lines) + "\n```\n"


text = tour.read_text()
tour.write_text(re.sub(r"    (?P<command>lacquer [^\n]*)\n\n```\n(?P<block>.*?)```\n", renewed, text, flags=re.DOTALL))
