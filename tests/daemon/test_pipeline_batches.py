"""Batches that do not begin and end with a cycle, as a busy bus gives them: nothing readable is kept back."""

from tests.daemon.test_pipeline import MS, Bench, running

SYNC = 0x080


def sync(bench: Bench) -> tuple[int, bytes, int]:
    return (SYNC, b"", bench.now_ns)


def test_a_complete_cycle_is_served_although_the_next_one_began_in_its_batch() -> None:
    bench = running()
    bench.pipeline.on_sync("arm", bench.now_ns)
    bench.now_ns += MS
    images = len(bench.images)
    bench.feed(bench.position(1, 45.0, 2), bench.position(2, 45.0, 2), sync(bench), bench.position(1, 46.0, 3))
    assert len(bench.images) == images + 1
    assert bench.fast(1)["raw"] == bench.fast(2)["raw"] == 45 * 3_600_000


def test_the_cycle_that_began_in_that_batch_is_served_when_its_last_joint_answered() -> None:
    bench = running()
    bench.feed(sync(bench), bench.position(1, 45.0, 2), bench.position(2, 45.0, 2), sync(bench))
    images = len(bench.images)
    bench.now_ns += MS
    bench.feed(bench.position(1, 46.0, 3))
    assert len(bench.images) == images
    bench.feed(bench.position(2, 46.0, 3), sync(bench))
    assert len(bench.images) == images + 1
    assert bench.fast(1)["raw"] == bench.fast(2)["raw"] == 46 * 3_600_000


def test_of_several_whole_cycles_in_a_batch_only_the_last_is_served() -> None:
    bench = running()
    images, passes = len(bench.images), bench.models[1].passes
    bench.feed(
        *(
            frame
            for number in (2, 3, 4)
            for frame in (sync(bench), bench.position(1, 45.0, number), bench.position(2, 45.0, number))
        )
    )
    assert len(bench.images) == images + 1
    assert bench.models[1].passes == passes + 1
    assert bench.fast(1)["sequence"] == 4


def test_a_joint_that_misses_the_last_sync_of_a_batch_does_not_keep_back_the_cycle_before() -> None:
    bench = running()
    bench.feed(
        sync(bench),
        bench.position(1, 45.0, 2),
        bench.position(2, 45.0, 2),
        sync(bench),
        bench.temperature(2, 25.0),
        bench.position(1, 46.0, 3),
    )
    assert bench.fast(2)["sequence"] == bench.fast(1)["sequence"] == 2
