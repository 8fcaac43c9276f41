"""Which columns are the time, and which joint's, in the spellings of camera programs and marker sets."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from .table import DeviceTable, shown
from .units import SECONDS, TIME, in_seconds, plain_unit, time_unit


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
#: Joints of a ZED's BODY_38 down to the hips; BODY_34 begins with Azure's, BODY_18 is OpenPose's.
ZED_38 = _listed(
    "PELVIS SPINE_1 SPINE_2 SPINE_3 NECK NOSE LEFT_EYE RIGHT_EYE LEFT_EAR RIGHT_EAR LEFT_CLAVICLE"
    " RIGHT_CLAVICLE LEFT_SHOULDER RIGHT_SHOULDER LEFT_ELBOW RIGHT_ELBOW LEFT_WRIST RIGHT_WRIST LEFT_HIP"
    " RIGHT_HIP"
)
#: Sets of points by how many there are; FreeMoCap's 553 (or 543) begin with BlazePose's.
POINT_SETS = {
    17: COCO_17, 18: OPENPOSE_18, 25: BODY_25, 26: COCO_17, 32: AZURE, 33: BLAZEPOSE, 133: COCO_17,
    75: BLAZEPOSE, 543: BLAZEPOSE, 553: BLAZEPOSE, 34: AZURE, 38: ZED_38,
}  # fmt: skip


def _meanings(**words: str) -> dict[str, str]:
    """What words mean, of the words of each meaning."""
    return {word: meaning for meaning, listed in words.items() for word in listed.split()}


#: Words that do not identify a joint.
_NOISE = set(
    _listed(
        "k 4 abt k4abt joint joints type body pose landmark landmarks keypoint world marker pos position"
        " skeleton lm kp kpt bone global filtered unfiltered mm cm m meter meters metre metres 3d 3 d rigid"
        " tracked coords coordinate coordinates"
    )
)
_SIDES = _meanings(
    left="l left lt links linke linker linkes gauche izquierda izquierdo izq",
    right="r right rt rechts rechte rechter rechtes droit droite derecha derecho",
)
#: German, French and Spanish words of joints, without accents.
_TRANSLATED = _meanings(
    shoulder="schulter schultergelenk epaule hombro",
    elbow="ellbogen ellenbogen ellbogengelenk coude codo",
    wrist="handgelenk poignet muneca",
    hand="main mano",
    head="kopf tete cabeza",
    neck="nacken hals cou cuello",
    hip="huefte hufte becken hanche bassin cadera",
    ankle="knoechel knochel sprunggelenk cheville tobillo",
    foot="fuss pied pie",
    knee="knie genou rodilla",
)
#: Chinese and Japanese words of sensors' tables.
_SIGNS = {"加速度": "acc", "角速度": "gyro", "角度": "angle", "磁场": "mag", "时间": "time", "時間": "time"}
_CENTRE_WORDS = {"center", "centre", "jc", "cj", "jcs", "cor"}
#: Short names of joint centres (Visual3D, OpenSim; Vicon's Plug-in Gait calls origins of its segments so).
_CENTRES = _meanings(shoulder="sjc shjc gh gjc ghjc clo", elbow="ejc huo", wrist="wjc rao")
#: Skin markers by their short names: joint, and which of a pair ("" = alone).
_SKIN = {
    word: (*meaning.split("_"), "")[:2]
    for word, meaning in _meanings(
        shoulder="sho acr acrom acromion ac sae",
        elbow_a="elb lel lelb elbl elblat hle lep epl lelbow",
        elbow_b="mel melb elbm elbmed hme mep epm melbow",
        wrist_a="wra rad radius rsp rs lwrist wrr wrl rst",
        wrist_b="wrb uln ulna usp us mwrist wru wrm ust",
        hand="fin",
    ).items()
}
_PAIR = _meanings(a="lat lateral radius radial rad thumb outer", b="med medial ulna ulnar uln pinky inner")
#: Parts of the body by which upright and the middle of the hips are found.
_OTHER = _meanings(
    top="head nose neck c7 cv7 clav strn sternum",
    hip="hip hips pelvis midhip asis psis asi psi hjc",
    foot="ankle heel foot calc toe ank hee knee bigtoe ajc",
)
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")


@dataclass(frozen=True)
class JointName:
    """What the name of a marker or joint means."""

    part: str  # `shoulder`, `elbow`, `wrist`, `hand`; or `top`, `hip`, `foot` of the rest of the body
    side: str  # "left", "right" or ""
    # "centre" (a joint's centre, said so), "joint" (a joint of a skeleton), "skin" (a marker on the skin)
    kind: str = "joint"
    pair: str = ""  # "a" or "b" where two skin markers are on both sides of the joint, else ""

    @property
    def joint(self) -> str:
        """Joint and side as the product names them (`wrist_right`); "" for the rest of the body."""
        return f"{self.part}_{self.side}" if self.part in ARM and self.side else ""


def words_of(name: str) -> list[str]:
    """Words of a name in small letters without accents: parted by signs and capitals (`JOINT_WristLeft`)."""
    text = name.replace("totalacc", "total_acc").rstrip(": ").rsplit(":", 1)[-1]
    if not text.isascii():
        for sign, word in _SIGNS.items():
            text = text.replace(sign, f" {word} ")
        parts = unicodedata.normalize("NFKD", text.replace("ß", "ss"))
        text = "".join(each for each in parts if not unicodedata.combining(each))
    return [word.lower() for word in _WORD.findall(text)]


@lru_cache(maxsize=4096)  # tables are recognised by the same names many times
def joint_name(name: str) -> JointName | None:
    """What a joint or marker is by its name."""
    words = [_TRANSLATED.get(word, word) for word in words_of(name)]
    words = [word for word in words if word not in _NOISE]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = [word for word in words if word not in _SIDES]
    side = sides[0] if len(set(sides)) == 1 else ""
    if not sides and rest:  # "lwrist", "RSHO": the side is the first letter
        glued = [word for word in rest if word[0] in "lr" and _is_part(word[1:])]
        if len(glued) == 1 and not any(_is_part(word) for word in rest if word not in glued):
            side = _SIDES[glued[0][0]]
            rest = [word[1:] if word in glued else word for word in rest]
    study, centre = "study" in rest, bool(_CENTRE_WORDS & set(rest))
    rest = [word for word in rest if word != "study" and word not in _CENTRE_WORDS]
    plain = [word for word in rest if word in ARM]
    pairs = [_PAIR[word] for word in rest if word in _PAIR]
    if len(plain) == 1 and side:
        others = [word for word in rest if word not in ARM and word not in _PAIR]
        if others or len(pairs) > 1 or (pairs and plain[0] not in ("elbow", "wrist")):
            return None
        kind = "skin" if pairs or (study and not centre) else "centre" if centre else "joint"
        return JointName(plain[0], side, kind, *pairs)
    if len(rest) == 1 and side:
        if rest[0] in _CENTRES:
            return JointName(_CENTRES[rest[0]], side, "centre")
        if rest[0] in _SKIN:
            part, pair = _SKIN[rest[0]]
            return JointName(part, side, "skin", pair)
    return next((JointName(_OTHER[word], side) for word in rest if word in _OTHER and not plain), None)


def _is_part(word: str) -> bool:
    return word in ARM or word in _CENTRES or word in _SKIN or word in _OTHER


_AXES = {"x": 0, "y": 1, "z": 2, "posx": 0, "posy": 1, "posz": 2, "tx": 0, "ty": 1, "tz": 2}
_CONFIDENCE = set(
    _listed(
        "c conf confidence state tracking tracked trackingstate visibility vis v score presence likelihood"
        " status level"
    )
)
#: Columns with one of these words are not positions.
_ELSE = set(
    _listed(
        "rot rotation orientation orient ori quat quaternion qx qy qz qw w euler roll pitch yaw depth color"
        " colour screen pixel px image img proj projected angle velocity vel acc speed residual"
        " reprojection error uncertainty sigma std cov q"
    )
)
_NORMALISED = {"norm", "normalized", "normalised"}
_NO_NAME = _CONFIDENCE | _NORMALISED | {"world"}


def _phrases(listed: str) -> tuple[str, ...]:
    return tuple(phrase.strip() for phrase in listed.split(","))


#: Names of columns in plain words (see `plain_words`), the best first.
BODY_WORDS = _phrases(
    "body idx, body id, bodyid, bodyidx, body, tracking id, trackingid, person, person id, skeleton id,"
    " skeletonid, user id, userid, user, player, player id, subject, track id, body index, body num, pose id,"
    " pose index, pose idx, id"
)
TIME_WORDS = _phrases(
    "epoch, epoc, timestamp, time stamp, timestamps, time, t, times, ts, sensor timestamp, event"
    " timestamp, timestamp nano, unix time, seconds elapsed, seconds, elapsed, elapsed realtime, elapsed"
    " time, date time, datetime, date, device, device timestamp, relative time, milliseconds, nanoseconds,"
    " system time, phone time, zeit, zeitstempel, zeitpunkt, temps, horodatage, tiempo, tempo, marca de"
    " tiempo, fecha, datum, clock, tick, ticks, system timestamp, frame time, time in, time since start"
    " in, unix, unix timestamp, epoch time, kinect time, host time, host timestamp, sensor time, captured"
    " at, capture time, time span, timespan, filetime"
)
FRAME_WORDS = _phrases("frame, frame number, frame no, frame index, frame idx, frame id, framenumber, index")


@dataclass
class JointColumns:
    """Columns (from 0) of a table with one row per frame and body."""

    # Columns of x, y, z by joint and side (`wrist_right`)
    axes: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    # Parts of the body that are not joints of an arm (hips, head)
    rest: list[tuple[JointName, tuple[int, int, int]]] = field(default_factory=list)
    # Column of the confidence or state by joint and side
    confidence: dict[str, int] = field(default_factory=dict)
    time: int | None = None  # Column of the time
    frame: int | None = None  # Column of the frame's number
    body: int | None = None  # Column of the body's number
    world: bool = False  # Columns that are named "world" were taken, beside others that are not
    normalised: bool = False  # Columns are named as normalised image coordinates
    numbered: bool = False  # Joints are numbered, not named (33 landmarks)
    # Columns of joints of an arm that have two axes and nowhere the third
    incomplete: set[str] = field(default_factory=set)

    def others(self, width: int) -> list[int]:
        """The columns of a table of that width that are nothing of these."""
        used = {at for three in (*self.axes.values(), *(each for _, each in self.rest)) for at in three}
        used |= {*self.confidence.values()} | {at for at in (self.frame, self.body) if at is not None}
        return [at for at in range(width) if at not in used]


def has_arm(joints: Iterable[str]) -> bool:
    """Whether there is a side with an elbow and a wrist or hand."""
    there = set(joints)
    sides = ("left", "right")
    return any(f"elbow_{side}" in there and {f"wrist_{side}", f"hand_{side}"} & there for side in sides)


def find_joint_columns(names: Sequence[str]) -> JointColumns:
    """Find the columns of the arms' joints by their names."""
    result = JointColumns()
    found: list[tuple[int, set[str], str, int | None]] = []  # column, words, what it is of, axis
    for at, name in enumerate(names):
        words = words_of(name)
        axes = [word for word in words if word in _AXES]
        rest = [word for word in words if word not in _AXES and word not in _NO_NAME]
        one_of_both = len(axes) <= 1 and bool(axes) != bool(_CONFIDENCE & set(words))
        if rest and one_of_both and not _ELSE & set(words):
            found.append((at, set(words), " ".join(rest), _AXES[axes[0]] if axes else None))
    result.world = any("world" in words for _, words, _, _ in found)
    if result.world:  # the same landmarks in the image beside those in the world
        found = [each for each in found if "world" in each[1]]
    result.normalised = bool(found) and all(_NORMALISED & words for _, words, _, _ in found)
    by_key: dict[str, dict[int | None, int]] = {}
    for at, _, key, axis in found:
        by_key.setdefault(key, {}).setdefault(axis, at)
    by_key = _named(by_key, result)
    lacking: dict[str, set[str]] = {}
    for key, columns in by_key.items():
        meaning, there = joint_name(key), {0, 1, 2} & columns.keys()
        if meaning is None:
            continue
        of_arm = bool(meaning.joint) and meaning.kind != "skin"
        if of_arm and len(there) == 2:
            lacking[meaning.joint] = {names[columns[axis]] for axis in there}
        if len(there) < 3:
            continue
        triple = (columns[0], columns[1], columns[2])
        if of_arm and meaning.joint not in result.axes:
            result.axes[meaning.joint] = triple
            if None in columns:
                result.confidence[meaning.joint] = columns[None]
        elif meaning.part not in ARM:
            result.rest.append((meaning, triple))
    for joint in lacking.keys() - result.axes.keys():
        result.incomplete |= lacking[joint]
    used = {at for triple in result.axes.values() for at in triple}
    free = [name if at not in used else "" for at, name in enumerate(names)]
    result.time, result.frame, result.body = (
        column_named(free, words) for words in (TIME_WORDS, FRAME_WORDS, BODY_WORDS)
    )
    return result


#: Words, and pairs of words, in names of joints that one program alone has.
_ONLY_OF: dict[str, set[str | tuple[str, str]]] = {
    "azure": {"navel", "naval", "clavicle", "k4abt"},
    "kinect": {
        *(("spine", part) for part in ("base", "shoulder", "mid")),
        ("hand", "tip"),
        ("joint", "type"),
    },
    "blazepose": {"pinky", "mouth", "visibility"},
}


def program_of(names: Sequence[str]) -> str:
    """Whose joints names are: `azure`, `kinect`, `blazepose`, or "" where nothing shows it."""
    listed = [words_of(name) for name in names]
    found = {word for words in listed for word in (*words, *pairwise(words))}
    return next((program for program, own in _ONLY_OF.items() if found & own), "")


@lru_cache(maxsize=4096)
def plain_words(name: str) -> str:
    """A column's name in plain words without its unit: `timestamp_usec` is `timestamp`."""
    words = words_of(name)
    return " ".join(word for word in words if word not in TIME or words == [word])


def time_unit_of(name: str) -> str:
    """The unit of time that a column's name states, "" where it states none."""
    return next((TIME[word] for word in reversed(words_of(name)) if word in TIME), "")


def column_named(names: Sequence[str], wanted: Sequence[str]) -> int | None:
    """The column whose plain words are the first of these that is there."""
    words = [plain_words(name) for name in names]
    return next((words.index(want) for want in wanted if want in words), None)


def _named(
    by_key: dict[str, dict[int | None, int]], result: JointColumns
) -> dict[str, dict[int | None, int]]:
    """Landmarks by their names where the columns number them (from 0 or 1)."""
    numbers: dict[int, dict[int | None, int]] = {}
    for key, columns in by_key.items():
        digits = [word for word in key.split() if word.isdigit()]
        if len(digits) == 1 and len({0, 1, 2} & columns.keys()) >= 2 and joint_name(key) is None:
            numbers.setdefault(int(digits[0]), columns)
    if any(name is not None and name.joint for name in map(joint_name, by_key)) or not numbers:
        return by_key
    first, last = min(numbers), max(numbers)
    base = 1 if (first, last) == (1, len(BLAZEPOSE)) else 0
    if last - base >= len(BLAZEPOSE) or len(numbers) < 6:
        return by_key  # some other set of points
    result.numbered = True
    return {BLAZEPOSE[number - base]: columns for number, columns in sorted(numbers.items())}


# ------------------------------------------------------------------------------------------ columns of times

#: This share of the steps of a column of times rises, and lies within these parts of the usual one.
_RISES, _EVEN, _EVEN_SHARE = 0.95, (0.3, 3.0), 0.8
#: Fewer rows than these rise by chance.
_FEWEST = 8


def time_column(table: DeviceTable) -> int | None:
    """The column that is the time by its name; without names the first."""
    if not table.labels:
        return 0
    exact = column_named(table.names, TIME_WORDS)
    first = 0 if table.labels[0].startswith(("time", "timestamp", "elapsed", "epoch")) else None
    return first if exact is None else exact


def stated_time_unit(table: DeviceTable, column: int) -> str:
    """The unit that a column of times states, in brackets or in its name; "" where it states none."""
    own = TIME.get(plain_unit(table.units[column]), "")
    return own or time_unit_of(table.names[column] if table.names else "")


def seconds(table: DeviceTable, column: int | None, unit: str = "s") -> FloatArray | None:
    """Times of a column, (n,) in s, dates since 1970; None for no column or one without times."""
    if column is None or not any(table.texts(column)[:2000]):
        return None
    times, dates = table.times(column)
    if dates or not np.isfinite(times).any():
        return times if np.isfinite(times).any() else None
    stated = TIME.get(plain_unit(table.units[column]), unit)
    fits = time_unit(stated, times) or stated
    note = f"Times are in {fits}, by the rate or the date that they give, not in {stated}."
    if fits != stated and note not in table.notes:
        table.notes.append(note)
    return in_seconds(times, fits)


def time_among(
    table: DeviceTable, free: Sequence[int], rates_hz: tuple[float, float], notes: list[str]
) -> tuple[int | None, str]:
    """The column that is the time and its unit ("iso" of dates), of those that nothing else is known of."""
    for at in free:
        name = shown(table.name(at).removeprefix("column "), 60)
        try:
            values, dates = table.times(at)
        except RecordingError:  # of words, not of times
            continue
        step = np.diff(values[np.isfinite(values)])
        moved = step[step != 0]
        rises = len(moved) and (moved > 0).mean() > _RISES
        if {"x", "y", "z", "w"} & set(words_of(name)) or len(values) < _FEWEST or not rises:
            continue
        if dates:
            return at, "iso"
        if len(moved) < 0.3 * (len(values) - 1):
            continue
        usual = float(np.median(moved))
        if usual == 1 and (values % 1 == 0)[np.isfinite(values)].all() and np.nanmax(values) < 1e11:
            notes.append(f"The column {name} counts rows or packets and is not the time.")
            continue
        unit = time_unit("", values, rates_hz)
        even = ((step > _EVEN[0] * usual) & (step < _EVEN[1] * usual)).mean() > _EVEN_SHARE
        if unit is None and not even:
            continue
        if unit is None or not even or not (step > 0).all() or not np.isfinite(values).all():
            raise RecordingError(
                f"{table.path} has no time by its name; its column {name} rises like one, in no certain unit:"
                " call it time_s, time_ms, time_us, time_ns or time_ticks, or describe it in a recording.toml"
                f" (`unocclude import describe {table.path}`)."
            )
        notes.append(
            f"The column {name} was taken for the time, in {unit}: it alone rises evenly, with"
            f" {1 / (usual * SECONDS[unit]):.4g} rows per second."
        )
        return at, unit
    return None, ""
