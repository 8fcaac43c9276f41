"""When the messages of a recording arrived, by its log times, and when they would have arrived without."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..array_types import IntArray
from ..io.mcap.container import Container
from ..io.mcap.messages import Topic
from ..io.recording.decode import ImuDecoder, plain_decoder
from ..io.recording.skeletons import SkeletonDecoder, skeleton_decoder

#: What a Kinect and its body tracking need for a frame, where the recording does not say it, s.
CAMERA_LATENCY_S = 0.1
#: Log times that are farther from the stamps are of another clock, ns.
_ONE_CLOCK_NS = 2_000_000_000


class LogTimes:
    """Stamps and log times of some topics of a file.

    Parameters
    ----------
    path : Path
        The file.
    imu, skeleton : str
        Topics as the reader calls them.
    """

    def __init__(self, path: Path, imu: str, skeleton: str):
        self._imu, self._skeleton = imu, skeleton
        self._stamp: dict[str, IntArray] = {}
        self._log: dict[str, IntArray] = {}
        container = Container(path)
        decoders: dict[str, ImuDecoder | SkeletonDecoder] = {}
        logs: dict[str, list[IntArray]] = {}

        def wanted(topic: Topic) -> bool:
            return topic.label in (imu, skeleton)

        for batch in container.by_topic(wanted):
            for position, messages in batch.items():
                topic = container.topics[position]
                if topic.label not in decoders:
                    decoder = plain_decoder(topic) or skeleton_decoder(topic)
                    if not isinstance(decoder, ImuDecoder | SkeletonDecoder):
                        continue
                    decoders[topic.label] = decoder
                decoders[topic.label].feed(messages)
                logs.setdefault(topic.label, []).append(messages.log_ns)
        for label, decoder in decoders.items():
            stamp = decoder.found()[0] if isinstance(decoder, SkeletonDecoder) else decoder.joined()[0]
            log = np.concatenate(logs[label])
            if len(stamp) == len(log):  # else messages are damaged
                self._stamp[label], self._log[label] = stamp, log

    def of_imu(self, stamp_ns: IntArray) -> IntArray:
        """When samples (n,) arrived, on the IMU's clock, ns; at their stamps where nothing says it."""
        return self._arrivals(self._imu, stamp_ns, 0)

    def of_frames(self, stamp_ns: IntArray, latency_s: float | None) -> tuple[IntArray, str]:
        """When frames (n,) arrived, on the IMU's clock, ns, and how that is known.

        Parameters
        ----------
        stamp_ns : ndarray of int, shape (n,), ns
        latency_s : float, s, optional
            Asked for; None takes the recording's log times, or `CAMERA_LATENCY_S` where they say nothing.
        """
        if latency_s is None and self._skeleton in self._log:
            delay = self._log[self._skeleton] - self._stamp[self._skeleton]
            if np.ptp(delay) > 0 or abs(float(np.median(delay))) > 0:
                arrival = self._arrivals(self._skeleton, stamp_ns, self._shift())
                return arrival, "Frames arrive when the recording's log times say."
        seconds = CAMERA_LATENCY_S if latency_s is None else latency_s
        return stamp_ns + round(seconds * 1e9), f"Frames arrive {seconds:g} s after their stamps."

    def _shift(self) -> int:
        """Log time less the IMU's clock, where those are different clocks, ns."""
        if self._imu not in self._log:
            return 0
        shift = int((self._log[self._imu] - self._stamp[self._imu]).min())
        return shift if abs(shift) > _ONE_CLOCK_NS else 0

    def _arrivals(self, topic: str, stamp_ns: IntArray, shift: int) -> IntArray:
        """Log times of the messages with these stamps, less a shift."""
        if topic not in self._log:
            return stamp_ns
        order = np.argsort(self._stamp[topic], kind="stable")
        at = np.searchsorted(self._stamp[topic][order], stamp_ns)
        at = order[np.minimum(at, len(order) - 1)]
        same = self._stamp[topic][at] == stamp_ns
        shift = shift or (self._shift() if topic == self._imu else 0)
        return np.where(same, self._log[topic][at] - shift, stamp_ns)
