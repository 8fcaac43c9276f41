"""One stream of the Lab Streaming Layer, received by a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..errors import UnoccludeError
from ..runtime.printable import printable
from .lsl_library import is_wanted, listed, lsl_module

#: Samples that are received together at most, and for how long the library holds them, s.
_MOST, _BUFFER_S = 512, 120
#: Waits of the thread: for streams to answer, for samples, for the first estimate of the clocks, s.
_RESOLVE_S, _PULL_S, _CLOCK_S = 1.0, 0.2, 3.0


class LslSamples(NamedTuple):
    """Samples that came together.

    Attributes
    ----------
    t_s : ndarray, shape (n,), s
        Stamps on this computer's LSL clock: as sent, and the library's time correction.
    values : ndarray, shape (n, channels)
    arrival_s : ndarray, shape (n,), s
        When they came, on the same clock.
    """

    t_s: FloatArray
    values: NDArray
    arrival_s: FloatArray


class LslInlet:
    """Receives a stream, also after it was lost.

    The library itself reconnects to a stream whose source_id comes back; one without is looked for again by
    its name.

    Parameters
    ----------
    wanted : str, optional
        Name (or a part of it) or source_id of the stream; None for the only one of its types.
    types : tuple of str
        Content types that are looked for where no name was given.
    wake : callable
        Called whenever something came.

    Attributes
    ----------
    wanted : str or None
        As given.
    stream : pylsl.StreamInfo or None
        Its full description once it was there.
    others : list of pylsl.StreamInfo
        All streams that answered last.
    correction_s : float, s
        Time correction in use; nan before it is known.
    """

    def __init__(self, wanted: str | None, types: tuple[str, ...], wake: Callable[[], None]):
        self.stream: Any = None
        self.others: list[Any] = []
        self.correction_s = float("nan")
        self.wanted, self._types, self._wake = wanted, types, wake
        self._samples: SimpleQueue[LslSamples] = SimpleQueue()
        self._failure: UnoccludeError | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="lsl-inlet", daemon=True)

    def start(self) -> None:
        """Look for the stream, and receive it."""
        self._thread.start()

    def samples(self) -> list[LslSamples]:
        """What came since the last call.

        Raises
        ------
        UnoccludeError
            Several streams are meant.
        """
        self.check()
        batches: list[LslSamples] = []
        try:
            while True:
                batches.append(self._samples.get_nowait())
        except Empty:
            return batches

    def check(self) -> None:
        """Raise what the thread failed by.

        Raises
        ------
        UnoccludeError
            Several streams are meant.
        """
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Stop receiving."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(3 * _RESOLVE_S)

    def _work(self) -> None:
        while not self._closing.is_set():
            try:
                inlet = self._connected()
                while inlet is not None and not self._closing.is_set():
                    self._receive(inlet)
            except UnoccludeError as failure:
                self._failure = failure
                self._wake()
                return
            except RuntimeError:  # the library's: lost, or no answer in time
                continue  # look for it again

    def _connected(self) -> Any:
        """An inlet of the stream once it is there; None where this ends before."""
        lsl = lsl_module()
        while not self._closing.is_set():
            self.others = list(lsl.resolve_streams(_RESOLVE_S))
            found = self._matching()
            if found is None:
                continue
            inlet = lsl.StreamInlet(found, max_buflen=_BUFFER_S, recover=bool(found.source_id()))
            stream = inlet.info(_CLOCK_S)
            if self.stream is not None and stream.channel_count() != self.stream.channel_count():
                raise UnoccludeError(
                    f"the stream {printable(stream.name())} came back with {stream.channel_count()} channels"
                    f" instead of {self.stream.channel_count()}; begin a new session"
                )
            self.correction_s = inlet.time_correction(_CLOCK_S)
            inlet.open_stream(_CLOCK_S)  # last: what waits inside has no arrival of its own
            self.stream = stream
            self._wake()
            return inlet
        return None

    def _matching(self) -> Any:
        """The stream that is meant among those that answered; None where it is not there."""
        if self.wanted is not None:
            exact = [s for s in self.others if self.wanted in (s.name(), s.source_id())]
            fitting = exact or [stream for stream in self.others if is_wanted(stream, self.wanted)]
        else:
            fitting = [stream for stream in self.others if stream.type().lower() in self._types]
        if len({stream.uid() for stream in fitting}) <= 1:
            return fitting[0] if fitting else None
        option = self.wanted if self.wanted is not None else "/".join(self._types)
        raise UnoccludeError(
            f"several streams are meant by {option}: {listed(fitting)}; give the whole name or the source_id"
        )

    def _receive(self, inlet: Any) -> None:
        values, stamps = inlet.pull_chunk(timeout=_PULL_S, max_samples=_MOST, min_samples=1, as_numpy=True)
        if not len(stamps):
            return
        arrival = lsl_module().local_clock()
        with suppress(lsl_module().util.TimeoutError):  # the one before holds until there is a new one
            self.correction_s = inlet.time_correction(0.0)
        t_s = np.asarray(stamps, float) + self.correction_s
        self._samples.put(LslSamples(t_s, np.asarray(values), np.full(len(t_s), arrival)))
        self._wake()
