"""What to simulate of a panel: its shape, where it is held, the camera, and every error."""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Point = tuple[float, float]


class PanelSimulation(BaseModel):
    """A panel with retroreflective markers before a depth camera like a Kinect v2."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    poses: int = Field(default=1, ge=1, le=200, description="panel poses")
    markers: tuple[Point, ...] = Field(
        default=((0.0, 0.0), (0.2, 0.0), (0.5, 0.0), (0.0, 0.35)),
        min_length=3,
        description="markers on the panel, m in {P}; the origin first",
    )
    extent: tuple[Point, Point] = Field(
        default=((-0.05, -0.05), (0.55, 0.40)), description="corners of the panel, m in {P}"
    )
    extra_markers: tuple[Point, ...] = Field(
        default=(), description="bright spots on the panel that its definition does not have, m in {P}"
    )
    hidden_markers: tuple[int, ...] = Field(default=(), description="markers that the camera cannot see")
    marker_shape: Literal["disc", "sphere"] = "disc"
    marker_height_m: float = Field(
        default=0.0, ge=0, le=0.1, description="centre of a spherical marker above the panel, m"
    )
    marker_diameter_m: float = Field(default=0.016, gt=0.002, le=0.06, description="of a marker, m")

    distance_m: Point = Field(default=(1.2, 1.9), description="panel's centre to camera, from and to, m")
    tilt_deg: Point = Field(
        default=(0.0, 25.0), description="panel's normal against the ray to the camera, from and to, degrees"
    )
    roll_deg: Point = Field(
        default=(0.0, 360.0), description="panel's x axis in the image, from and to, degrees"
    )
    hand: bool = Field(default=True, description="a hand holds the panel, a person stands behind it")
    distractors: int = Field(
        default=0, ge=0, le=10, description="bright spots beside the panel in each image"
    )

    width: int = Field(default=512, ge=64, le=4096, description="of the images, pixels")
    height: int = Field(default=424, ge=64, le=4096, description="of the images, pixels")
    focal_px: float = Field(default=365.5, gt=50, description="focal length, pixels")
    distortion: tuple[float, float, float, float, float] = Field(
        default=(0.09, -0.27, 0.0006, -0.0004, 0.095), description="k1, k2, p1, p2, k3"
    )
    blur_px: float = Field(default=0.5, ge=0, le=3, description="sigma of the lens' blur, pixels")
    marker_gain: float = Field(
        default=2.5, gt=0, description="a marker's brightness at 1.5 m, in full scales of the infrared image"
    )
    infrared_noise: float = Field(default=0.02, ge=0, description="sigma, a fraction of the value")
    depth_noise_m: float = Field(
        default=0.0015, ge=0, description="sigma of a depth at 1.5 m, m; grows with distance and angle"
    )
    depth_offset_m: float = Field(default=0.0, description="added to every depth, m")
    halo_m: float = Field(
        default=0.01, ge=0, description="depth error beside a marker, m; fades within some pixels"
    )
    flying: float = Field(
        default=0.3, ge=0, le=1, description="fraction of the pixels on rims that show a depth in between"
    )
    quantised: bool = Field(default=True, description="round depths to whole millimetres")
    mocap_noise_m: float = Field(default=0.0002, ge=0, description="sigma of a mocap marker, m per axis")

    hold_s: float = Field(default=2.0, ge=1, le=60, description="how long each pose is held, s")
    move_s: float = Field(default=2.5, ge=1, le=60, description="from one pose to the next, s")
    sway_deg: float = Field(default=0.05, ge=0, description="rms of the hand's sway in a hold, degrees")
    camera_tilt_deg: float = Field(
        default=0.0,
        ge=0,
        le=60,
        description="the camera and its base IMU are tilted anew for each pose, up to",
    )
    imu_mounting_deg: float = Field(
        default=3.0, ge=0, le=180, description="the panel's IMU sits off the panel's axes, degrees"
    )
    imu_rate_hz: float = Field(default=100.0, ge=20, le=1000, description="IMU samples per second")
    accelerometer_noise: float = Field(default=0.002, ge=0, description="density, m/s^2/sqrt(Hz)")
    gyroscope_noise: float = Field(default=0.0002, ge=0, description="density, rad/s/sqrt(Hz)")
    accelerometer_bias: float = Field(default=0.02, ge=0, description="sigma of the bias, m/s^2 per axis")
    gyroscope_bias: float = Field(default=0.005, ge=0, description="sigma of the bias, rad/s per axis")
    imu_scale: float = Field(default=0.001, ge=0, description="sigma of each axis' scale error")
    magnetometer: bool = Field(default=False, description="both IMUs have a magnetometer")
    magnetometer_noise: float = Field(default=0.4, ge=0, description="sigma of a sample, uT per axis")
    magnetometer_bias: float = Field(default=0.5, ge=0, description="sigma of what iron adds, uT per axis")

    @classmethod
    def ideal(cls, **changes: Any) -> Self:
        """No error at all and no person in the picture: for tests of the geometry."""
        none: dict[str, Any] = {
            "hand": False,
            "infrared_noise": 0.0,
            "depth_noise_m": 0.0,
            "halo_m": 0.0,
            "flying": 0.0,
            "mocap_noise_m": 0.0,
            "sway_deg": 0.0,
            "accelerometer_noise": 0.0,
            "gyroscope_noise": 0.0,
            "accelerometer_bias": 0.0,
            "gyroscope_bias": 0.0,
            "imu_scale": 0.0,
            "magnetometer_noise": 0.0,
            "magnetometer_bias": 0.0,
        }
        return cls(**{**none, **changes})

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        (x0, y0), (x1, y1) = self.extent
        if x0 >= x1 or y0 >= y1:
            raise ValueError("extent must go from the lower to the upper corner")
        if not all(x0 <= x <= x1 and y0 <= y <= y1 for x, y in self.markers + self.extra_markers):
            raise ValueError("a marker lies outside the panel's extent")
        for name in ("distance_m", "tilt_deg", "roll_deg"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} must go from the smaller to the larger value")
        if self.distance_m[0] < 0.3 or self.distance_m[1] > 6:
            raise ValueError("distance_m must lie within 0.3 and 6")
        if self.tilt_deg[0] < 0 or self.tilt_deg[1] > 89:
            raise ValueError("tilt_deg must lie within 0 and 89")
        if any(not 0 <= index < len(self.markers) for index in self.hidden_markers):
            raise ValueError("hidden_markers names a marker that is not there")
        return self
