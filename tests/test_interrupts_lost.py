"""An interrupt in a destructor is printed by Python and forgotten: ours is raised again."""

import signal
import time

import pytest

from lambent.interrupts import watched


class Thing:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def dropped():
    with watched():
        thing = Thing()
        del thing
        time.sleep(2)


def test_an_interrupt_in_a_destructor_is_not_lost(capfd):
    with pytest.raises(KeyboardInterrupt):
        dropped()
    assert "Traceback" not in capfd.readouterr().err
