"""Packages that may be missing, Open3D where the system lacks libusb, and the C library."""

from __future__ import annotations

import ctypes
import platform
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from types import ModuleType

from ..errors import UnoccludeError

#: Open3D without CUDA, where there is a wheel of it.
OPEN3D = "open3d-cpu" if sys.platform == "linux" and platform.machine() == "x86_64" else "open3d"
#: Modules that the light installation (.ci/light.txt) leaves out, and the packages that contain them.
LEFT_OUT = {
    "cv2": "opencv-python-headless",
    "open3d": OPEN3D,
    "libusb_package": "libusb-package",
    "dask": "dask",
    "distributed": "distributed",
}


def missing_package(error: ImportError) -> str:
    """One sentence on a module that is not there; "" where the program never leaves it out."""
    module = (error.name or "").partition(".")[0]
    if not isinstance(error, ModuleNotFoundError) or module not in LEFT_OUT:
        return ""
    return (
        f"this needs {LEFT_OUT[module]}, which is not installed; get it with `pip install {LEFT_OUT[module]}`"
    )


def extra_module(
    name: str, package: str, extra: str, needs: Sequence[str] = (), submodules: Sequence[str] = ()
) -> ModuleType:
    """A module of an extra."""
    try:
        module = import_module(name)
        for submodule in submodules:
            import_module(f"{name}.{submodule}")
    except ImportError as error:
        raise UnoccludeError(
            f"this needs {package}, which is not installed; get it with `pip install '.[{extra}]'`"
            " in the program's folder"
        ) from error
    if not all(hasattr(module, need) for need in needs):
        version = getattr(module, "__version__", "")
        raise UnoccludeError(
            f"{package}{f' {version}' if version else ''} is too old; `pip install -U '.[{extra}]'` in the"
            " program's folder"
        )
    return module


def pandas_module() -> ModuleType:
    """The package `pandas`, which only `to_dataframe()` needs."""
    try:
        return import_module("pandas")
    except ImportError as error:
        raise UnoccludeError("to_dataframe() needs pandas; install it by `pip install pandas`") from error


def load_open3d() -> ModuleType:
    """Import Open3D; where libusb-1.0 is missing, with the one of the package `libusb-package`."""
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
        raise ImportError("libusb-package has no library for this system")
    ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)


def _forget(package: str) -> None:
    """Drop what a failed import left behind, so that the next one starts anew."""
    for name in [name for name in sys.modules if name == package or name.startswith(f"{package}.")]:
        del sys.modules[name]


#: Parameters of glibc's `mallopt`: blocks smaller than the first are taken from the heap, at whose end up to
#: the second stays free, bytes.
_MMAP_THRESHOLD, _TRIM_THRESHOLD = (-3, 32 << 20), (-1, 16 << 20)


def keep_freed_memory() -> None:
    """Keep what is freed for what is needed next, instead of giving it back to the system at once."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # other C libraries have no such parameters
            library = ctypes.CDLL(None)
            for parameter, size in (_MMAP_THRESHOLD, _TRIM_THRESHOLD):
                library.mallopt(parameter, size)
