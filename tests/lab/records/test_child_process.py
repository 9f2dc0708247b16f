"""Child processes: their output, their end, and their replacement."""

import os
import signal

import pytest

from masking.lab.records.child_process import Child, Supervisor

LIMIT = 20.0  # s


def running(code):
    return Child("timeit", ["-n1", "-r1", f"import os, signal, time\n{code}"])


def test_lines_are_read_one_by_one_and_the_status_at_the_end():
    child = running("print(1); print(2, flush=True); os._exit(7)")
    assert [child.line(), child.line(), child.line()] == ["1", "2", ""]
    assert child.wait() == 7
    assert not child.is_alive


def test_a_child_that_asks_for_more_time_is_killed_at_the_limit():
    child = running("signal.signal(15, signal.SIG_IGN); print('here', flush=True); time.sleep(60)")
    assert child.line() == "here"
    assert child.end(0.05) == -signal.SIGKILL


def test_a_child_that_is_asked_to_end_may_do_so_in_order():
    child = running("signal.signal(15, lambda *_: os._exit(3)); print('', flush=True); time.sleep(60)")
    child.line()
    assert child.is_alive
    assert child.end(LIMIT) == 3


def test_output_is_whole_and_an_interrupt_ends_the_child():
    assert running("print(1); print(2)").output(LIMIT).startswith("1\n2\n")
    child = running("time.sleep(60)")

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with pytest.raises(KeyboardInterrupt):
            child.output(LIMIT)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert not child.is_alive


def supervised(status, most):
    def start():
        return running(f"os._exit({status})")

    made = Supervisor(start(), start, most=most, final=[4], name="test")
    made.join(LIMIT)
    return made


@pytest.mark.parametrize(
    ("status", "failures"), [(0, ()), (5, (5, 5, 5)), (4, (4,))], ids=["in order", "too often", "for good"]
)
def test_a_child_that_fails_is_replaced_up_to_a_number(status, failures):
    made = supervised(status, 3)
    assert made.failures == failures
    assert (made.child is None) == bool(failures)


def test_a_child_that_is_killed_is_replaced():
    children = [running("time.sleep(60)"), running("pass")]
    made = Supervisor(children[0], lambda: children[1], most=2, final=[], name="test")
    os.kill(children[0].pid, signal.SIGKILL)
    made.join(LIMIT)
    assert (made.child, made.failures) == (children[1], (-signal.SIGKILL,))


def test_where_none_can_be_started_there_is_none():
    def start():
        raise OSError

    made = Supervisor(running("os._exit(1)"), start, most=5, final=[], name="test")
    made.join(LIMIT)
    assert made.child is None


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="priorities of Linux")
@pytest.mark.parametrize("policy", ["SCHED_OTHER", "SCHED_RR"])
def test_a_child_behind_others_takes_no_real_time_priority(policy):
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, getattr(os, policy), os.sched_param(int(policy == "SCHED_RR")))
    except OSError:
        pytest.skip("no real-time priority is permitted here")
    try:
        child = Child("timeit", ["-n1", "-r1", "import time; time.sleep(60)"], nice=7)
    finally:
        os.sched_setscheduler(0, *before)
    assert (os.sched_getscheduler(child.pid), os.getpriority(os.PRIO_PROCESS, child.pid)) == (os.SCHED_OTHER, 7)
    child.end(0.0)
