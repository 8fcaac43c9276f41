"""`python -m tools.live_faults [--seeds 1 2] [--only TEXT ..] [--say]`: faults fed into the live smoother.

Prints for each kind the time with an error beyond three stated sigmas, that without an answer, the largest
error in sigmas with the sigma that was stated, the error of the last five seconds, after how long something
was said or doubted, and what was done; ends with 1 where it was wrong for longer than 0.5 s.
"""

from __future__ import annotations

import argparse
import os
import sys
from functools import partial

os.environ.setdefault("OMP_NUM_THREADS", "1")

#: A kind holds where the answer is wrong for no longer, s.
MOST_S = 0.5
#: A session of a minute on a busy machine takes no longer, s.
LONGEST_S = 400.0


def main() -> int:
    """Run the kinds, and print the table."""
    from tools.live_faults.bench import Sound, forked, simulated, verdict_of
    from tools.live_faults.kinds import KINDS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--only", nargs="+", default=[""], help="kinds whose name contains one of these")
    parser.add_argument("--duration-s", type=float, default=32.0)
    parser.add_argument("--at-s", type=float, default=17.0, help="when the fault begins")
    parser.add_argument("--preset", default="realistic", help="the camera")
    parser.add_argument("--imus", default="wrist", help="where IMUs are worn, as `simulate arm --imus`")
    parser.add_argument("--on", default="forearm", help="the segment whose IMU is at fault: upper_arm")
    parser.add_argument("--say", action="store_true", help="print what the session said, too")
    options = parser.parse_args()
    bad = set()
    print(f"{'kind':51} seed  wrong s   no answer  worst cm  sigma  end cm  said s  done")
    kinds = [kind for kind in KINDS if any(text in kind for text in options.only)]
    for seed in options.seeds:
        arm = simulated(seed, options.duration_s, preset=options.preset, imus=options.imus)
        sound = Sound(arm, options.at_s)
        for kind in kinds:
            v = forked(partial(verdict_of, kind, seed, sound, options.on), LONGEST_S)
            mark = " <--" if v.wrong_s > MOST_S else ""
            bad |= {v.kind} if mark else set()
            print(
                f"{v.kind:51} {v.seed:4} {v.wrong_s:8.2f} {v.silent_s:11.2f} {100 * v.worst_m:9.1f}"
                f" {100 * v.at_sigma_m:6.1f} {v.sound_cm:7.1f} {v.said_s:7.2f}  {v.ended}{mark}",
                flush=True,
            )
            if options.say and v.said:
                print(*(f"    {line}" for line in v.said), sep="\n", flush=True)
    print(f"{len(bad)} of {len(kinds)} kinds are wrong for more than {MOST_S:g} s")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
