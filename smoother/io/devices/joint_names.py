"""Names of joints and markers, in the spellings of camera programs and marker sets."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache


def _listed(names: str) -> list[str]:
    return names.split()


#: Joints of an arm that are read from files.
ARM = ("shoulder", "elbow", "wrist", "hand")
#: 33 landmarks of BlazePose in their order (MediaPipe's documentation of the pose landmarker).
BLAZEPOSE = _listed(
    "nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer left_ear right_ear"
    " mouth_left mouth_right left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist"
    " left_pinky right_pinky left_index right_index left_thumb right_thumb left_hip right_hip left_knee"
    " right_knee left_ankle right_ankle left_heel right_heel left_foot_index right_foot_index"
)
#: 32 joints of the Azure Kinect Body Tracking SDK (`k4abt_joint_id_t`), which Orbbec's wrapper uses too.
AZURE = _listed(
    "PELVIS SPINE_NAVEL SPINE_CHEST NECK CLAVICLE_LEFT SHOULDER_LEFT ELBOW_LEFT WRIST_LEFT HAND_LEFT"
    " HANDTIP_LEFT THUMB_LEFT CLAVICLE_RIGHT SHOULDER_RIGHT ELBOW_RIGHT WRIST_RIGHT HAND_RIGHT HANDTIP_RIGHT"
    " THUMB_RIGHT HIP_LEFT KNEE_LEFT ANKLE_LEFT FOOT_LEFT HIP_RIGHT KNEE_RIGHT ANKLE_RIGHT FOOT_RIGHT HEAD"
    " NOSE EYE_LEFT EAR_LEFT EYE_RIGHT EAR_RIGHT"
)
#: 25 joints of the Kinect v2's SDK (`JointType`).
KINECT_V2 = _listed(
    "SpineBase SpineMid Neck Head ShoulderLeft ElbowLeft WristLeft HandLeft ShoulderRight ElbowRight"
    " WristRight HandRight HipLeft KneeLeft AnkleLeft FootLeft HipRight KneeRight AnkleRight FootRight"
    " SpineShoulder HandTipLeft ThumbLeft HandTipRight ThumbRight"
)
#: OpenPose's BODY_25, whose first 18 are not those of its COCO model.
BODY_25 = _listed(
    "Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist MidHip RHip RKnee RAnkle LHip LKnee LAnkle"
    " REye LEye REar LEar LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel"
)
OPENPOSE_18 = _listed(
    "Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist RHip RKnee RAnkle LHip LKnee LAnkle REye LEye"
    " REar LEar"
)
#: COCO's 17 keypoints; HALPE_26 and COCO's 133 of the whole body begin with them.
COCO_17 = _listed(
    "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow"
    " left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle"
)
#: Sets of points by how many there are; FreeMoCap's 553 (or 543) begin with BlazePose's.
POINT_SETS = {
    17: COCO_17, 18: OPENPOSE_18, 25: BODY_25, 26: COCO_17, 32: AZURE, 33: BLAZEPOSE, 133: COCO_17,
    75: BLAZEPOSE, 543: BLAZEPOSE, 553: BLAZEPOSE,
}  # fmt: skip

#: Words that say nothing of which joint is meant.
_NOISE = {
    *(
        "k",
        "4",
        "abt",
        "k4abt",
        "joint",
        "joints",
        "type",
        "body",
        "pose",
        "landmark",
        "landmarks",
        "keypoint",
    ),
    *("world", "marker", "pos", "position", "skeleton", "lm", "kp", "kpt", "bone", "global", "filtered"),
    *("mm", "cm", "m", "meter", "meters", "metre", "metres"),
    *("unfiltered", "3d", "3", "d", "rigid", "tracked", "coords", "coordinate", "coordinates"),
}
_SIDES = {"l": "left", "left": "left", "lt": "left", "r": "right", "right": "right", "rt": "right"}
_CENTRE_WORDS = {"center", "centre", "jc", "cj", "jcs", "cor"}
#: Short names of joint centres (Visual3D, OpenSim; Vicon's Plug-in Gait calls origins of its segments so).
_CENTRES = {
    **dict.fromkeys(("sjc", "shjc", "gh", "gjc", "ghjc", "clo"), "shoulder"),
    **dict.fromkeys(("ejc", "huo"), "elbow"),
    **dict.fromkeys(("wjc", "rao"), "wrist"),
}
#: Skin markers by their short names: joint, and which of a pair ("" = alone).
_SKIN = {
    **dict.fromkeys(("sho", "acr", "acrom", "acromion", "ac", "sae"), ("shoulder", "")),
    **dict.fromkeys(("elb", "lel", "lelb", "elbl", "elblat", "hle", "lep", "epl", "lelbow"), ("elbow", "a")),
    **dict.fromkeys(("mel", "melb", "elbm", "elbmed", "hme", "mep", "epm", "melbow"), ("elbow", "b")),
    **dict.fromkeys(("wra", "rad", "radius", "rsp", "rs", "lwrist", "wrr", "wrl", "rst"), ("wrist", "a")),
    **dict.fromkeys(("wrb", "uln", "ulna", "usp", "us", "mwrist", "wru", "wrm", "ust"), ("wrist", "b")),
    "fin": ("hand", ""),
}
_PAIR = {
    **dict.fromkeys(("lat", "lateral", "radius", "radial", "rad", "thumb", "outer"), "a"),
    **dict.fromkeys(("med", "medial", "ulna", "ulnar", "uln", "pinky", "inner"), "b"),
}
#: Parts of the body by which upright and the middle of the hips are found.
_OTHER = {
    **dict.fromkeys(("head", "nose", "neck", "c7", "cv7", "clav", "strn", "sternum"), "top"),
    **dict.fromkeys(("hip", "hips", "pelvis", "midhip", "asis", "psis", "asi", "psi", "hjc"), "hip"),
    **dict.fromkeys(("ankle", "heel", "foot", "calc", "toe", "ank", "hee", "knee", "bigtoe", "ajc"), "foot"),
}
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")


@dataclass(frozen=True)
class JointName:
    """What the name of a marker or joint means.

    Attributes
    ----------
    part : str
        `shoulder`, `elbow`, `wrist`, `hand`; or `top`, `hip`, `foot` of the rest of the body.
    side : str
        "left", "right" or "".
    kind : str
        "centre" (a joint's centre, said so), "joint" (a joint of a skeleton), "skin" (a marker on the skin).
    pair : str
        "a" or "b" where two skin markers lie on both sides of the joint, else "".
    """

    part: str
    side: str
    kind: str = "joint"
    pair: str = ""

    @property
    def joint(self) -> str:
        """Joint and side as the product names them (`wrist_right`); "" for the rest of the body."""
        return f"{self.part}_{self.side}" if self.part in ARM and self.side else ""


def words_of(name: str) -> list[str]:
    """Words of a name in small letters: parted by signs and by capitals (`K4ABT_JOINT_WristLeft`)."""
    return [word.lower() for word in _WORD.findall(name.rsplit(":", 1)[-1])]


@lru_cache(maxsize=4096)  # tables are recognised by the same names many times
def joint_name(name: str) -> JointName | None:
    """What a joint or marker is by its name.

    Parameters
    ----------
    name : str
        As a file has it: `WRIST_RIGHT`, `RWrist`, `r_wrist`, `WristRight`, `K4ABT_JOINT_WRIST_RIGHT`,
        `right_wrist`, `RWJC`, `r_lwrist_study`, `Subject:RWRA`.

    Returns
    -------
    JointName or None
        None where it is nothing of an arm, and nothing that shows how the body stands.
    """
    words = [word for word in words_of(name) if word not in _NOISE]
    return _meaning(tuple(words))


def _meaning(words: tuple[str, ...]) -> JointName | None:
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = [word for word in words if word not in _SIDES]
    side = sides[0] if len(set(sides)) == 1 else ""
    if not sides and rest:  # "lwrist", "RSHO": the side is the first letter
        glued = [word for word in rest if word[0] in "lr" and _is_part(word[1:])]
        if len(glued) == 1 and not any(_is_part(word) for word in rest if word not in glued):
            side = _SIDES[glued[0][0]]
            rest = [word[1:] if word in glued else word for word in rest]
    study = "study" in rest
    rest = [word for word in rest if word != "study"]
    centre = any(word in _CENTRE_WORDS for word in rest)
    rest = [word for word in rest if word not in _CENTRE_WORDS]
    plain = [word for word in rest if word in ARM]
    pairs = [_PAIR[word] for word in rest if word in _PAIR]
    if len(plain) == 1 and side:
        others = [word for word in rest if word not in ARM and word not in _PAIR]
        if others or len(pairs) > 1:
            return None
        if pairs:
            return JointName(plain[0], side, "skin", pairs[0]) if plain[0] in ("elbow", "wrist") else None
        return JointName(plain[0], side, "centre" if centre else "skin" if study else "joint")
    if len(rest) == 1 and side:
        word = rest[0]
        if word in _CENTRES:
            return JointName(_CENTRES[word], side, "centre")
        if word in _SKIN:
            part, pair = _SKIN[word]
            return JointName(part, side, "skin", pair)
    return next((JointName(_OTHER[word], side) for word in rest if word in _OTHER and not plain), None)


def _is_part(word: str) -> bool:
    return word in ARM or word in _CENTRES or word in _SKIN or word in _OTHER
