"""Box_bots that drive circles: `python -m benchmarks.peers KIND ROBOTS SECONDS`; prints JSON."""

import sys

import msgspec

from benchmarks.peers.plain_fleets import KINDS

if __name__ == "__main__":
    kind, robots, seconds = sys.argv[1:]
    driven = KINDS[kind](int(robots), float(seconds))
    sys.stdout.write(msgspec.json.encode(driven).decode() + "\n")
