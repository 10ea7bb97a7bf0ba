import threading

import pytest

from heliograph.output.background import Background


class Noted:
    """Notes which job ran in which thread, and holds until it may go on."""

    def __init__(self):
        self.gate, self.done, self.threads = threading.Event(), [], set()

    def job(self, value):
        def work():
            self.gate.wait(10.0)
            self.threads.add(threading.current_thread().name)
            self.done.append(value)
            if value == 99:
                raise MemoryError("no room")

        return work


def test_background_does_jobs_in_order_in_one_other_thread():
    noted, background = Noted(), Background(threaded=True)
    background.do(noted.job(0))
    background.do(noted.job(1))
    assert noted.done == []  # both calls returned although nothing was done
    noted.gate.set()
    for value in range(2, 40):
        background.do(noted.job(value))
    background.wait()
    assert noted.done == list(range(40))
    assert len(noted.threads) == 1
    assert threading.current_thread().name not in noted.threads
    background.close()


def test_background_without_a_thread_does_jobs_at_once():
    noted, background = Noted(), Background(threaded=False)
    noted.gate.set()
    background.do(noted.job(1))
    assert noted.done == [1] and noted.threads == {threading.current_thread().name}
    background.close()


def test_background_raises_the_first_failure_later_and_goes_on():
    noted, background = Noted(), Background(threaded=True)
    noted.gate.set()
    background.do(noted.job(99))
    background.do(noted.job(99))
    with pytest.raises(MemoryError, match="no room"):
        background.wait()
    background.wait()  # the second one was under way when the first was raised
    background.do(noted.job(2))
    background.wait()
    assert noted.done == [99, 99, 2]
    background.close()
