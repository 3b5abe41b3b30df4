"""Changes the bundle of a team at 1 kHz again and again, kills processes in the midst, and tells what it cost.

    python3 benches/changes.py 100
    python3 benches/changes.py 1000 --kill 10 --hog --record runs/changes.mcap --up="--rt 10"    # pip install mcap lz4
    python3 benches/changes.py 1000 --kill 10 --hog --pause 0.5    # the same without changes

The programs are those of `cargo build --release -p sortie -p sortie-tools`.
"""

import argparse
import collections
import json
import os
import random
import signal
import struct
import subprocess
import time
from pathlib import Path

SORTIE = "target/release/sortie"
BUNDLES = ["models/save-the-city", "models/save-the-city-large"]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, help="how many changes")
    parser.add_argument("--kill", type=int, metavar="N", help="kill a process at a random moment of every Nth")
    parser.add_argument("--hog", action="store_true", help="let another program take a core")
    parser.add_argument("--pause", type=float, metavar="S", help="wait for so long in place of every change")
    parser.add_argument("--record", type=Path, metavar="FILE", help="record, and look for ticks of two bundles")
    parser.add_argument("--up", default="", metavar="FLAGS", help="further flags of `sortie up`")
    return parser.parse_args()


def processes(domain):
    """Those that decide, by their ids; none before the team is up."""
    told = subprocess.run([SORTIE, "control", "info", "--domain", domain, "--json"], capture_output=True)
    rows = json.loads(told.stdout) if told.returncode == 0 else []
    rows = rows if isinstance(rows, list) else rows["processes"]
    return [row.get("pid", row.get("process")) for row in rows if row["role"] in ("runner", "allocator", "standby")]


def change(number, domain, given):
    """The exit code of one change, during which somebody may be killed."""
    reload = [SORTIE, "control", "reload", BUNDLES[number % 2], "--domain", domain]
    command = ["sleep", str(given.pause)] if given.pause else reload
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    if given.kill and number % given.kill == 0:
        while not (deciding := processes(domain)):
            time.sleep(0.05)
        victim = random.choice(deciding)
        time.sleep(random.uniform(0, 0.5))
        os.kill(victim, signal.SIGKILL)
    return running.wait()


def decided_by_two(record):
    """Ticks on record, and those of which actions name two models."""
    from mcap.reader import make_reader

    models = collections.defaultdict(set)
    for part in sorted(record.parent.glob(f"{record.stem}*{record.suffix}")):
        with part.open("rb") as file:
            for _, _, message in make_reader(file).iter_messages(topics=["/action"]):
                # ActionMsg, docs/reference/wire.md: the tick at byte 16, the model at 32.
                tick, _, model = struct.unpack_from("<QQI", message.data, 16)
                models[tick].add(model)
    return len(models), sum(len(names) > 1 for names in models.values())


def main():
    given = arguments()
    random.seed(1)
    domain = f"changes-{os.getpid()}"
    up = [SORTIE, "up", BUNDLES[0], "--rate", "1000", "--isolate", "--domain", domain, "--json", *given.up.split()]
    team = subprocess.Popen(up, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    hog = subprocess.Popen(["sha256sum", "/dev/zero"]) if given.hog else None
    recorder = None
    try:
        while not processes(domain):
            time.sleep(0.2)
        time.sleep(2)
        if given.record:
            record = [SORTIE, "record", BUNDLES[0], "--domain", domain, "--split", "500MB", "--output", given.record]
            recorder = subprocess.Popen(record)
            time.sleep(1)
        codes = collections.Counter(change(number, domain, given) for number in range(1, given.count + 1))
    finally:
        team.send_signal(signal.SIGINT)
        told = json.loads(team.communicate()[0] or "{}")
        if recorder:
            recorder.wait()
        if hog:
            hog.kill()
    skipped, ticks = told["skipped_periods"], told["ticks"]
    print(f"{given.count} changes, by exit code {dict(codes)}: {skipped} periods skipped beside {ticks} ticks")
    if given.record:
        print("{} ticks on record, {} of two bundles".format(*decided_by_two(given.record)))


main()
