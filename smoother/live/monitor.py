"""Whether the camera contradicts the answer, and who is wrong then.

Every frame is compared with what the last solution predicts, which finds jumps, and with what a solution half
a second before it predicts by the IMU alone, which finds a camera that was followed into an error. A jump of
the camera, and joints that rest while the IMU moves, are the camera's fault: its frames are left out until
they fit again; if they never do, the tracker begins anew. Everything else is the IMU's: the camera leads for
a while.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import length
from ..recording import FOREARM_JOINTS, JOINTS
from ..selfcal.self_calibration import SelfCalibration
from ..window.problem import NoiseModel
from ..window.solution import LagSolution
from .imu import Suspicion
from .signal import LiveSignal, joint_at, predict

#: A joint contradicts where its squared error in sigmas is above this (three axes), and farther off, m.
CONTRADICTS, CONTRADICTS_M = 30.0, 0.06
#: The camera's slow error, m per axis, which its noise does not contain.
SLOW_M = 0.017
#: A solution of this age, s, is compared with every second frame; this many in a row must contradict it.
BEFORE_S, EACH, FRAMES_IN_A_ROW = 0.45, 2, 3
#: .. with a mean squared error per axis, in sigmas, above this.
CONTRADICTS_BEFORE = 9.0
#: Frames fit again where this many in a row do, with a squared error in sigmas below this.
FITS_IN_A_ROW, FITS = 3, 12.0
#: .. and that are nearer than this share of the jump, or than this, m: a wide sigma lets another body fit.
FITS_SHARE, FITS_M = 0.4, 0.12
#: A shoulder this far from where it was is another one, m.
SHOULDER_M = 0.3
#: The camera is left out for no longer than this, s; after a gap the tracker may have strayed by itself: s.
LONGEST_S, LONGEST_AFTER_GAP_S = 6.0, 1.0
#: .. and as long as what the IMU says alone is this good, m per axis.
PREDICTED_M = 0.25
#: Frames before a contradiction that decide what it is.
LOOKED_AT = 16
#: Joints that move less than this share of what the IMU says, and the least motion that counts, m.
RESTS_SHARE, MOVED_M = 0.35, 0.06
#: .. and how far the gyroscope turns the wrist about the elbow at least, m, in at most this many seconds.
TURNED_M, TURNED_WITHIN_S = 0.10, 0.8
#: A joint jumps by itself where it is this far from its own last motion, m, and by this share of what it is
#: from the prediction.
JUMPS_M, JUMPS_SHARE = 0.12, 0.5
#: The IMU is doubted for so long, s, and twice as long, up to the second, where it was within the third.
DOUBT_S, LONGEST_DOUBT_S, DOUBTED_AGAIN_S = 0.5, 4.0, 2.0
#: .. and from this long before a frame that contradicts at once.
DOUBT_BEFORE_S = 0.2
#: Values that repeat while the IMU turns or is shaken, rad/s and m/s^2.
FROZEN_REPEATS, FROZEN_RATE, FROZEN_FORCE = 2, 0.15, 0.5

_FOREARM = [JOINTS.index(joint) for joint in ("elbow", "wrist")]
_COLUMNS = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
_SHOULDER = JOINTS.index("shoulder")
_NOTHING: BoolArray = np.zeros(len(JOINTS), bool)


class Culprit(Enum):
    """Who is wrong."""

    NOBODY = "nobody"
    CAMERA = "camera"
    IMU = "imu"
    TRACKER = "tracker"


@dataclass(frozen=True)
class FrameFinding:
    """What a frame says."""

    accepted: BoolArray  # bool (5,): joints that are used
    cause: Culprit = Culprit.NOBODY  # New with this frame; `NOBODY` while nothing changes
    sentence: str = ""  # Of what changed
    retract_s: float = np.inf  # Frames after this are to be taken back; inf for none
    doubt_s: tuple[float, float] = (0.0, 0.0)  # From when to when the IMU is to be doubted
    again: bool = False  # It had been doubted a moment before: the clocks may be apart


@dataclass(frozen=True)
class JointResiduals:
    """The joints in a frame against a solution; nan where a joint is not compared."""

    residual: FloatArray  # (5, 3) m: camera less prediction
    covariance: FloatArray  # (5, 3, 3) m^2: of the residual
    place: FloatArray  # (5, 3) m: predicted
    predicted_m: float  # Standard deviation of the predicted position, worst axis
    used: BoolArray  # bool (5,): which are compared

    @property
    def squared(self) -> FloatArray:
        """Squared error in sigmas of each joint that is compared (k,), of three axes."""
        residual = self.residual[self.used]
        whitened = np.linalg.solve(self.covariance[self.used], residual[:, :, None])[:, :, 0]
        return np.asarray(np.sum(residual * whitened, axis=1))

    @property
    def off_m(self) -> FloatArray:
        """Distances of those joints (k,) from the prediction."""
        return np.asarray(np.linalg.norm(self.residual[self.used], axis=1))

    @property
    def mean_squared(self) -> float:
        """Squared error in sigmas of the joints' mean, per axis: what they share is not noise."""
        mean = self.residual[self.used].mean(axis=0)
        # their errors are nearly the prediction's, which they share
        return float(mean @ np.linalg.solve(self.covariance[self.used].mean(axis=0), mean)) / 3.0


@dataclass(frozen=True)
class _Seen:
    """A frame that was looked at: its time, raw joints, residuals against the solution half a second ago."""

    t_s: float
    position: FloatArray
    accepted: BoolArray
    before: JointResiduals | None
    now: JointResiduals

    @property
    def shows_forearm(self) -> bool:
        """The camera sees elbow and wrist, and both are predicted."""
        return bool(self.now.used[_FOREARM].all())


class CameraMonitor:
    """Compares every frame with the answer."""

    def __init__(self, model: SelfCalibration, noise: NoiseModel, signal: LiveSignal) -> None:
        self._model, self._noise, self._signal = model, noise, signal
        self.since_s: float | None = None
        self.sound_since_s = np.inf
        self._limit_s, self._jump_m = LONGEST_S, np.inf
        self._solutions: deque[LagSolution] = deque()
        self._seen: deque[_Seen] = deque(maxlen=LOOKED_AT)
        self._waited: deque[_Seen] = deque(maxlen=LOOKED_AT // 2)
        self._bad = self._fits = self._repeats = self._resting = 0
        self._count = 0
        self._suspicion = Suspicion(DOUBT_S, LONGEST_DOUBT_S, DOUBTED_AGAIN_S)
        self._visible_s = -np.inf

    def solved(self, solution: LagSolution) -> None:
        """Remember a solution that the camera took part in."""
        if self.since_s is None and self._bad == 0:
            self._solutions.append(solution)
        while len(self._solutions) > 1 and self._solutions[1].newest.t < solution.newest.t - BEFORE_S:
            self._solutions.popleft()

    def judge(
        self,
        t_s: float,
        position: FloatArray,  # (5, 3) m
        accepted: BoolArray,  # bool (5,)
        solution: LagSolution | None,
    ) -> FrameFinding:
        """Which joints of a frame are used, and whether something is wrong."""
        if solution is None:
            return FrameFinding(accepted)
        accepted = self._with_shoulder(accepted, position, solution)
        if not accepted[_COLUMNS].any():
            return FrameFinding(accepted)
        if self._is_frozen(t_s, position, accepted):
            return self._left_out(t_s, "its joints repeat while the IMU moves", np.inf)
        now = self._against(solution, t_s, position, accepted)
        if now is None:
            return FrameFinding(accepted)
        first = self._solutions[0] if self._solutions else None
        before, self._count = None, self._count + 1
        if first is not None and self._count % EACH == 0 and t_s - first.newest.t < 2.0 * BEFORE_S:
            before = self._against(first, t_s, position, accepted)
        self._seen.append(_Seen(t_s, position, accepted, before, now))
        self._resting = self._resting + 1 if self._rests_while_turning() else 0
        if self.since_s is not None:
            return self._waiting(t_s, now, accepted)
        if self._resting >= FRAMES_IN_A_ROW:
            self._limit_s, self._jump_m = LONGEST_S, np.inf
            return self._left_out(t_s, _RESTS, self._seen[0].t_s)
        after_gap, self._visible_s = t_s - self._visible_s > 0.3, t_s
        wrong = (now.squared > CONTRADICTS) & (now.off_m > CONTRADICTS_M)
        if wrong.all():
            if after_gap or self._jumps(now):
                self._limit_s = LONGEST_AFTER_GAP_S if after_gap else LONGEST_S
                self._jump_m = float(now.off_m.mean())
                return self._left_out(t_s, "it jumped away from the IMU's prediction", np.inf)
            return self._imu_wrong(t_s, t_s - DOUBT_BEFORE_S, accepted)
        if before is not None and first is not None:
            self._bad = self._bad + 1 if before.mean_squared > CONTRADICTS_BEFORE else 0
            if self._bad >= FRAMES_IN_A_ROW:
                return self._contradicted(t_s, first, accepted)
        if self._bad == 0 and not np.isfinite(self.sound_since_s):
            self.sound_since_s = t_s
        left = accepted.copy()
        left[np.flatnonzero(now.used)[wrong]] = False
        return FrameFinding(left)

    def _against(
        self, solution: LagSolution, t_s: float, position: FloatArray, accepted: BoolArray
    ) -> JointResiduals | None:
        """A frame against a solution before it."""
        names, used = list(solution.levers), np.zeros(len(JOINTS), bool)
        used[[k for k in _COLUMNS if accepted[k] and JOINTS[k] in names]] = True
        if not used.any() or t_s < solution.newest.t - 1e-6:
            return None
        prediction = predict(solution, self._signal, t_s, self._noise)
        state, whole = prediction.state, prediction.covariance(names)
        place, covariance = np.full((len(JOINTS), 3), np.nan), np.full((len(JOINTS), 3, 3), np.nan)
        for k in np.flatnonzero(used):
            number = names.index(JOINTS[k])
            place[k], spread = joint_at(state.R, state.p, solution.levers[JOINTS[k]], number, whole)
            covariance[k] = spread + (self._model.joint_sigma_m[k] ** 2 + SLOW_M**2) * np.eye(3)
        predicted_m = float(np.sqrt(np.linalg.eigvalsh(whole[3:6, 3:6])[-1]))
        return JointResiduals(position - place, covariance, place, predicted_m, used)

    def _with_shoulder(self, accepted: BoolArray, position: FloatArray, solution: LagSolution) -> BoolArray:
        """Without a shoulder that is not where it was, or of a camera that is left out."""
        if not accepted[_SHOULDER] or solution.shoulder is None:
            return accepted
        is_other = length(position[_SHOULDER] - solution.shoulder) > SHOULDER_M
        if not is_other and (self.since_s is None or accepted[_COLUMNS].any()):
            return accepted
        left = accepted.copy()
        left[_SHOULDER] = False
        return left

    def _is_frozen(self, t_s: float, position: FloatArray, accepted: BoolArray) -> bool:
        """Whether the joints repeat exactly while the IMU moves."""
        if not self._seen or not (position == self._seen[-1].position)[accepted].all():
            self._repeats = 0
            return False
        self._repeats += 1
        if self._repeats < FROZEN_REPEATS:
            return False
        edges = np.linspace(t_s - 0.1, t_s, 6)
        signal = self._signal.since(edges[0])
        if signal.end_s < t_s - 0.03:
            return False
        rate = signal.mean(edges[:-1], edges[1:])
        turning = float(np.linalg.norm(rate[:, 3:], axis=1).max())
        return turning > FROZEN_RATE or float(np.ptp(np.linalg.norm(rate[:, :3], axis=1))) > FROZEN_FORCE

    def _left_out(self, t_s: float, why: str, retract_s: float) -> FrameFinding:
        """From this frame on the camera takes no part."""
        since_s, self._fits, self._bad, self.sound_since_s = self.since_s, 0, 0, np.inf
        if since_s is not None:
            is_over = t_s - since_s > self._limit_s
            return FrameFinding(_NOTHING, Culprit.TRACKER, _ANEW) if is_over else FrameFinding(_NOTHING)
        self.since_s = t_s
        self._waited.clear()
        return FrameFinding(_NOTHING, Culprit.CAMERA, f"the camera is left out: {why}", retract_s)

    def _waiting(self, t_s: float, now: JointResiduals, accepted: BoolArray) -> FrameFinding:
        """The camera takes no part: does it fit again, or is it time to begin anew?"""
        near_m = max(FITS_M, FITS_SHARE * self._jump_m)
        fits = (now.squared < FITS) & (now.off_m < near_m)
        self._fits = self._fits + 1 if fits.all() else 0
        assert self.since_s is not None
        self._waited.append(self._seen[-1])
        first, last = self._waited[0], self._waited[-1]
        rests = _rests(first, first.now, last, last.now)
        if self._fits >= FITS_IN_A_ROW and not rests:
            away_s, self.since_s = t_s - self.since_s, None
            self._solutions.clear()
            self._visible_s = t_s
            return FrameFinding(accepted, Culprit.NOBODY, f"the camera fits again, after {away_s:.1f} s")
        if rests:
            self._limit_s = LONGEST_S  # it is not the tracker that strayed
        if t_s - self.since_s > self._limit_s or now.predicted_m > PREDICTED_M:
            return FrameFinding(_NOTHING, Culprit.TRACKER, _ANEW)
        return FrameFinding(_NOTHING)

    def _jumps(self, now: JointResiduals) -> bool:
        """Whether the camera's newest frame leaves its own motion, as no arm does."""
        if len(self._seen) < 3:
            return True
        two, one, new = (self._seen[k] for k in (-3, -2, -1))
        if new.t_s - two.t_s > 0.25:
            return True
        rows = now.used & one.accepted & two.accepted
        rate = (one.position[rows] - two.position[rows]) / (one.t_s - two.t_s)
        left = new.position[rows] - one.position[rows] - rate * (new.t_s - one.t_s)
        limits = np.maximum(JUMPS_M, JUMPS_SHARE * np.linalg.norm(now.residual[rows], axis=1))
        return bool(np.sum(np.linalg.norm(left, axis=1) > limits) > 0.5 * rows.sum()) or not rows.any()

    def _imu_wrong(self, t_s: float, since_s: float, accepted: BoolArray) -> FrameFinding:
        """The camera's motion is smooth and not what the IMU says: the camera leads."""
        again = self._suspicion.renew(since_s, t_s)
        self._solutions.clear()
        self._bad, self.sound_since_s = 0, np.inf
        doubt_s, sentence = (since_s, self._suspicion.until_s), "" if again else _IMU_WRONG
        return FrameFinding(accepted, Culprit.IMU, sentence, doubt_s=doubt_s, again=again)

    def _contradicted(self, t_s: float, first: LagSolution, accepted: BoolArray) -> FrameFinding:
        """The last half second does not fit to the IMU: say who is wrong."""
        frames = [each for each in self._seen if each.before is not None and each.t_s > first.newest.t + 1e-6]
        oldest, last = frames[0], frames[-1]
        assert oldest.before is not None and last.before is not None
        if _rests(oldest, oldest.before, last, last.before):
            self._limit_s, self._jump_m = LONGEST_S, np.inf
            return self._left_out(t_s, _RESTS, first.newest.t)
        return self._imu_wrong(t_s, first.newest.t, accepted)

    def _rests_while_turning(self) -> bool:
        """Whether elbow and wrist rest while the gyroscope turns the forearm: needs no good velocity."""
        new = self._seen[-1]
        old = next((each for each in self._seen if each.t_s > new.t_s - TURNED_WITHIN_S), new)
        if not (old.shows_forearm and new.shows_forearm):
            return False
        (elbow, wrist), (elbow_seen, wrist_seen) = (
            after[_FOREARM] - before[_FOREARM]
            for after, before in ((new.now.place, old.now.place), (new.position, old.position))
        )
        turned = length(wrist - elbow)
        moved = max(length(elbow_seen), length(wrist_seen), length(wrist_seen - elbow_seen))
        return turned >= TURNED_M and moved < RESTS_SHARE * turned


def _rests(first: _Seen, before: JointResiduals, last: _Seen, after: JointResiduals) -> bool:
    """Whether the joints hardly moved from one frame to another, while they did by the IMU."""
    rows = before.used & after.used
    moved = np.linalg.norm(after.place - before.place, axis=1)[rows].max(initial=0.0)
    seen = np.linalg.norm(last.position - first.position, axis=1)[rows].max(initial=0.0)
    return bool(moved > MOVED_M and seen < max(RESTS_SHARE * moved, 0.02))


_IMU_WRONG = "the IMU does not fit the camera's motion; the camera is followed meanwhile"
_RESTS = "its joints are frozen while the IMU moves"
_ANEW = "camera and solution contradict each other, and it is unclear which is wrong: the smoother restarts"
