"""The first Ctrl-C or SIGTERM stops a command, wherever it arrives."""

import gc
import os
import signal
import time

import pytest

from planspace.cli.interrupts import Interrupted, interruptible

needs_posix = pytest.mark.skipif(os.name != "posix", reason="POSIX signals")


@needs_posix
def test_a_signal_in_a_callback_of_the_garbage_collection_is_not_lost() -> None:
    sent = []

    def callback(phase: str, info: dict) -> None:
        if not sent:
            sent.append(phase)
            os.kill(os.getpid(), signal.SIGTERM)

    gc.callbacks.append(callback)
    try:
        with pytest.raises(Interrupted, match="SIGTERM"), interruptible(whole_process=False):
            gc.collect()
            assert sent
            time.sleep(5)
    finally:
        gc.callbacks.remove(callback)
