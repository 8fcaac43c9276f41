"""Which IMU is on which body and limb, by motion alone."""

from .excerpt_motion import Limb, limbs_of
from .match import METHODS, SURE_FROM, ImuMatch, PairEvidence, decide, match_imus, pair_evidence

__all__ = [
    "METHODS",
    "SURE_FROM",
    "ImuMatch",
    "Limb",
    "PairEvidence",
    "decide",
    "limbs_of",
    "match_imus",
    "pair_evidence",
]
