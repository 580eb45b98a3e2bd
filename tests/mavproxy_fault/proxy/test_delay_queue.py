"""Delayed frames leave in the order of their due times, and of equal ones as they came."""

import heapq
import random

from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.delay_queue import COUNT, MOST, DelayQueue, follow_simulator, put
from mavproxy_fault.proxy.interfaces import NEVER_US, LinkRole
from mavproxy_fault.proxy.statistics import format_endpoints, link_statistics


def test_what_is_due_first_leaves_first_whatever_comes_and_goes_meanwhile() -> None:
    rng, queue, expected = random.Random(5), DelayQueue(), []
    for n in range(4000):
        if n < 2000 and (not expected or rng.random() < 0.6):
            item = (rng.randrange(100), n, n % 7, b"%d" % n)
            heapq.heappush(expected, item)
            queue.hold(item[0], item[2], item[3])
        elif expected:
            due_us, _, links, raw = heapq.heappop(expected)
            assert queue.first_us == due_us
            assert queue.release() == (links, raw)
    assert not expected
    assert queue.first_us == NEVER_US


def test_a_full_queue_takes_no_more_and_counts_what_it_loses() -> None:
    roles = [LinkRole(name, "to-vehicle", datagrams=True) for name in ("a", "b", "c")]
    core = Core(roles, None)
    core.waiting.numbers[COUNT] = MOST
    assert put(core.waiting.numbers, 5, 0b110, 9) == -1
    core.waiting.hold(5, 0b100, b"late")
    assert core.waiting.numbers[COUNT] == MOST
    points = [link_statistics(core, number) for number in range(3)]
    assert [point["delays_lost"] for point in points] == [0, 1, 2]
    *_, last = format_endpoints(points).splitlines()
    assert last == "c: 2 delayed frames lost, as 262144 were waiting"


def test_a_second_simulator_or_a_new_start_moves_no_delayed_frame() -> None:
    queue = DelayQueue()
    follow_simulator(queue.numbers, 1_000_000, 500_000_000)
    queue.hold(500_200_000, 1, b"late")
    follow_simulator(queue.numbers, 700_000_000, 500_001_000)  # another clock
    follow_simulator(queue.numbers, 1_002_000, 500_002_000)
    assert queue.first_us == 500_200_000
    follow_simulator(queue.numbers, 1_006_000, 500_005_000)  # 4 ms in 3
    assert queue.first_us == 500_199_000
