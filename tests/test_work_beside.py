"""What goes on beside a stage of a run: an error or an interrupt ends it, and what went wrong there is told."""

import re
import threading
from concurrent.futures import Future

import pytest

from ebamcheck.errors import InputError
from ebamcheck.pipeline.job import one_beside


def ended(error: BaseException, works: list[Future]) -> None:
    """End a block by an error while one work goes on until the other, which waits for it, is dropped."""
    released = threading.Event()
    with one_beside() as aside:
        works += [aside.submit(released.wait, 60.0), aside.submit(lambda: "begun")]
        works[1].add_done_callback(lambda _: released.set())
        raise error


@pytest.mark.parametrize("error", [InputError("no such part"), KeyboardInterrupt()])
def test_an_error_drops_what_has_not_begun_and_waits_for_what_has(error):
    works: list[Future] = []
    with pytest.raises(type(error)):
        ended(error, works)
    assert works[0].result(timeout=0.0) is True
    assert works[1].cancelled()


def test_what_went_wrong_beside_is_told_where_its_result_is_asked_for():
    text = "blade-fine.stl: no triangle"

    def lost():
        raise InputError(text)

    with one_beside() as aside:
        work = aside.submit(lost)
        with pytest.raises(InputError, match=re.escape(text)):
            work.result()


def test_an_interrupt_tells_work_that_has_begun_and_what_waits_after_it_is_dropped():
    ended, begun = threading.Event(), threading.Event()
    works: list[Future] = []

    def stops_when_told() -> bool:
        begun.set()
        return ended.wait(60.0)

    def interrupted() -> None:
        with one_beside(ended=ended) as aside:
            works.extend([aside.submit(stops_when_told), aside.submit(lambda: "begun")])
            assert begun.wait(60.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert works[0].result(timeout=0.0) is True
    assert works[1].cancelled()
