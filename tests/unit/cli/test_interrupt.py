"""Signals that ask a run to end."""

import signal

import pytest

from heliograph.cli.interrupt import EndedError, ends_in_order, interruptible
from heliograph.cli.main import main

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.mark.parametrize("number", SIGNALS)
def test_first_signal_asks_and_the_second_ends_at_once(number, capsys):
    # Whoever starts the tests in the background may have them ignore Ctrl-C, which would stay so.
    found = signal.signal(number, signal.default_int_handler)
    before = signal.getsignal(number)
    with interruptible() as asked:
        assert not asked()
        signal.raise_signal(number)
        assert asked() and asked.code == 128 + number
        assert "saving what is done" in capsys.readouterr().err
        with pytest.raises(EndedError) as caught:
            signal.raise_signal(number)
        assert caught.value.code == 128 + number
    assert signal.getsignal(number) is before
    signal.signal(number, found)


@pytest.mark.parametrize("number", SIGNALS[1:])
def test_signal_that_was_ignored_stays_ignored(number):
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with interruptible() as asked:
            signal.raise_signal(number)
            assert not asked()
    finally:
        signal.signal(number, before)


@pytest.mark.parametrize("number", SIGNALS[1:])
def test_command_that_a_signal_ends_says_so_and_has_its_exit_code(number, monkeypatch, capsys):
    """Typer takes every `KeyboardInterrupt` for Ctrl-C, whose exit code is another."""
    monkeypatch.setattr("heliograph.sim.find_scenario", lambda _: signal.raise_signal(number))
    assert main(["simulate", "room"]) == 128 + number
    assert capsys.readouterr().err.strip() == f"error: ended by {signal.Signals(number).name}"


@pytest.mark.parametrize("number", SIGNALS[1:])
def test_what_is_open_is_released_on_the_way_out(number):
    released = []

    def ended():
        with ends_in_order():
            try:
                signal.raise_signal(number)
            finally:
                released.append(number)

    with pytest.raises(EndedError) as caught:
        ended()
    assert released == [number] and caught.value.code == 128 + number
