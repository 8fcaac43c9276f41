"""Every kind of output, byte for byte, to compare a rebuilding with: `python -m tools.reference`."""

import os

# before NumPy is imported: processes are forked, and a library's threads do not survive that
os.environ.setdefault("OMP_NUM_THREADS", "1")
