"""What `mediapipe.tasks.python` names."""

from dataclasses import dataclass

from . import vision as vision


@dataclass
class BaseOptions:
    """Where the model is."""

    model_asset_path: str | None = None
    model_asset_buffer: bytes | None = None
