"""What a joint's sequence numbers tell: frozen nodes, old frames, counters that start anew."""

from tests.daemon.test_pipeline import MS, running

from trueangle.core.health import NodeCondition, StatusBit


def test_old_frames_that_come_again_in_their_order_are_no_counter_that_starts_anew() -> None:
    bench = running()
    for sequence in range(2, 10):
        bench.cycle(sequence, angle_deg=90.0 + sequence)
    bench.feed(*(bench.position(1, 90.0 + sequence, sequence) for sequence in (5, 6, 7, 8)))
    bench.pipeline.tick(bench.now_ns)
    assert bench.fast(1)["raw"] == 99 * 3_600_000


def test_a_node_that_froze_before_it_came_into_service_is_never_valid() -> None:
    bench = running()
    bench.pipeline.on_node(1, NodeCondition.SILENT, bench.now_ns)
    bench.pipeline.on_node(1, NodeCondition.RUNNING, bench.now_ns)
    for sequence in range(2, 20):
        bench.pipeline.on_sync("arm", bench.now_ns)
        bench.now_ns += MS
        bench.feed(bench.temperature(1, 20.0), bench.position(1, 90.0, 1), bench.position(2, 90.0, sequence))
        assert StatusBit.VALID not in bench.status(1)
        bench.now_ns += 4 * MS


def test_a_counter_that_starts_again_close_behind_is_followed_when_it_is_past_where_it_stood() -> None:
    bench = running()
    for sequence in (2, 3, 4):
        bench.cycle(sequence)
    for sequence in (0, 1, 2, 3, 4):
        bench.cycle(sequence, angle_deg=92.0)
        assert bench.fast(1)["raw"] == 90 * 3_600_000
    bench.cycle(5, angle_deg=92.0)
    assert bench.fast(1)["raw"] == 92 * 3_600_000


def test_a_counter_that_starts_again_is_followed_from_its_second_sample() -> None:
    bench = running()
    for sequence in (50, 100, 104):
        bench.cycle(sequence)
    bench.cycle(0, angle_deg=91.0)
    assert bench.fast(1)["raw"] == 90 * 3_600_000
    bench.cycle(1, angle_deg=92.0)
    assert bench.fast(1)["raw"] == 92 * 3_600_000
    assert StatusBit.VALID in bench.status(1)
