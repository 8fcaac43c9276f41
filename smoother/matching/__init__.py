"""Which IMU is on which body and limb, by motion alone."""

from .limbs import Limb, limbs_of
from .match import METHODS, SURE_FROM, ImuMatch, match_imus

__all__ = ["METHODS", "SURE_FROM", "ImuMatch", "Limb", "limbs_of", "match_imus"]
