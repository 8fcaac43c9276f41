"""Open3D, also where the system lacks libusb: the wheel links against it and ships without it."""

from __future__ import annotations

import ctypes
import sys
from types import ModuleType


def load_open3d() -> ModuleType:
    """Import Open3D; where libusb-1.0 is missing, with the one of the package `libusb-package`.

    Raises
    ------
    ImportError
        Open3D is not installed, or another of its libraries is missing.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        if "libusb" not in str(error):
            raise
        _load_packaged_libusb()
        _forget("open3d")
        import open3d
    return open3d


def _load_packaged_libusb() -> None:
    """Load the packaged libusb for all to link against: its soname then serves Open3D."""
    import libusb_package

    path = libusb_package.get_library_path()
    if path is None:
        raise ImportError("libusb-package holds no library for this system")
    ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)


def _forget(package: str) -> None:
    """Drop what a failed import left behind, so that the next one starts anew."""
    for name in [name for name in sys.modules if name == package or name.startswith(f"{package}.")]:
        del sys.modules[name]
