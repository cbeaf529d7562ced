"""Ctrl-C and SIGTERM: the first stops the command, which saves what is finished; the next ends it at once."""

import contextlib
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SAME_PRESS_S = 0.5
"""A signal this soon after the first counts as the same: `timeout` and some shells send it twice."""
AGAIN_S = 0.05
"""After this time, a signal is sent again [s]; see `_sending_again`."""


class Interrupted(KeyboardInterrupt):
    """A signal arrived that asks the command to stop."""

    def __init__(self, number: int):
        super().__init__(signal.Signals(number).name)
        self.number = number
        self.exit_code = 128 + number


@contextlib.contextmanager
def interruptible(*, whole_process: bool) -> Iterator[None]:
    """Raise `Interrupted` at the first signal inside the block; end the process at the next one.

    Signals that the process ignores, as a shell sets them up for background commands, stay ignored.

    Args:
        whole_process: whether the process ends after the block. After an interrupt, signals are then handled
            in this way until its end.
    """
    if threading.current_thread() is not threading.main_thread():  # only the main thread can handle signals
        yield
        return
    usual = (signal.SIG_DFL, signal.default_int_handler)
    before = {number: signal.getsignal(number) for number in SIGNALS}
    before = {number: handler for number, handler in before.items() if handler in usual}
    arrivals, wakeup = socket.socketpair()
    wakeup.setblocking(False)
    arrived: list[int] = []
    resent: list[int] = []

    def stop(number: int, frame: object) -> None:
        if not arrived:
            arrived.append(number)
            raise Interrupted(number)

    threading.Thread(target=_end_at_second, args=(arrivals, set(before), resent), daemon=True).start()
    wakeup_before = signal.set_wakeup_fd(wakeup.fileno(), warn_on_full_buffer=False)
    try:
        for number in before:
            signal.signal(number, stop)
        with _sending_again(arrived, resent):
            yield
    finally:
        if arrived and whole_process:
            wakeup.detach()  # stays open
        else:
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(wakeup_before)
            wakeup.close()


@contextlib.contextmanager
def _sending_again(arrived: list[int], resent: list[int]) -> Iterator[None]:
    """Send a signal again if Python only prints its exception, as in a callback of the garbage collection.

    Args:
        arrived: the signal that arrived; emptied in this case.
        resent: gets the signals that are sent again.
    """
    hook_before = sys.unraisablehook

    def send(number: int) -> None:
        resent.append(number)
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(threading.main_thread().ident or 0, number)  # also ends its sleep
        else:
            signal.raise_signal(number)

    def ignored(unraisable: "sys.UnraisableHookArgs") -> None:
        if not isinstance(error := unraisable.exc_value, Interrupted):
            hook_before(unraisable)
            return
        arrived.clear()
        threading.Timer(AGAIN_S, send, (error.number,)).start()

    sys.unraisablehook = ignored
    try:
        yield
    finally:
        sys.unraisablehook = hook_before


def _end_at_second(arrivals: socket.socket, numbers: set[int], resent: list[int]) -> None:
    """Watch for signals in a thread, because the main thread may be inside a long call in C.

    Args:
        arrivals: gives the number of each signal.
        numbers: the signals that are watched for.
        resent: signals that were sent again, which are no new ones; taken off as they arrive.
    """
    first = None
    with arrivals:
        while arrival := arrivals.recv(1):
            if arrival[0] not in numbers:
                continue
            if resent:
                resent.pop()
                continue
            if first is not None and time.monotonic() - first > SAME_PRESS_S:
                os._exit(128 + arrival[0])
            first = first or time.monotonic()
