"""The tests on every Python that is promised: `nox -f tools/noxfile.py`, or `make pythons`."""

from __future__ import annotations

from pathlib import Path

import nox

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.11", "3.12", "3.13")

nox.options.default_venv_backend = "uv|virtualenv"
nox.options.envdir = str(ROOT / "out" / "nox")  # not among the modules that the tests read


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """All tests in an environment made of the lock; arguments go to pytest."""
    session.chdir(ROOT)
    session.install("--require-hashes", "--only-binary", ":all:", "-r", "requirements.lock")
    session.install("--no-deps", "--no-build-isolation", "-e", ".")
    arguments = session.posargs or ("-n", "2", "--dist", "loadfile")
    # As `make test` does: by the module, so that this folder's own `tools` is the one that is imported.
    session.run("python", "-m", "pytest", *arguments, env={"OMP_NUM_THREADS": "1"})
