"""Draw a set of hidden-effects cases and seal what is hidden.

SET.json lists id, seed and kind of the cases, shuffled; KEY.json holds their truths, by id; KEY.sha256
is the hash of ids, seeds, kinds and names of effects, which ``form-drake bench blind`` compares.
Cases are made from their seeds (``hidden_effects.py --noisy``); no floating-point number is hashed.
"""

import argparse
import hashlib
import json
from pathlib import Path

import numpy as np
from hidden_effects_cases import case_of

COUNTS = {"single": 60, "near": 30, "null": 40, "pair": 15, "outside": 20, "noise": 10}
SEEDS = 10**8  # seeds are drawn below


def drawn_set(seed, counts):
    """The truths of a set, shuffled."""
    rng = np.random.default_rng(seed)
    kinds = rng.permutation(np.repeat(list(counts), list(counts.values())))
    seeds = rng.choice(SEEDS, len(kinds), replace=False)
    return [case_of(int(s), str(kind)) for s, kind in zip(seeds, kinds, strict=True)]


def digest(key):
    """SHA-256 of ids, seeds, kinds and names of effects."""
    told = [[n, t["seed"], t["kind"], sorted(t["effects"])] for n, t in sorted(key.items())]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def main():
    """Write SET.json, KEY.json and KEY.sha256."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--set", type=Path, default=Path("set.json"))
    parser.add_argument("--key", type=Path, default=Path("key.json"))
    for kind, count in COUNTS.items():
        parser.add_argument(f"--{kind}", type=int, default=count, help=f"by default {count}")
    args = parser.parse_args()
    truths = drawn_set(args.seed, {kind: getattr(args, kind) for kind in COUNTS})
    listed = [{k: t[k] for k in ("id", "seed", "kind")} for t in truths]
    key = {t["id"]: t for t in truths}
    args.set.write_text(json.dumps(listed, indent=0) + "\n")
    args.key.write_text(json.dumps(key, indent=1) + "\n")
    args.key.with_suffix(".sha256").write_text(f"{digest(key)}  {args.key.name}\n")


if __name__ == "__main__":
    main()
