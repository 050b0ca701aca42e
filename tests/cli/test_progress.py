"""What a running growth shows."""

import io

import pytest
from rich.console import Console

from jaxgrow.cli.progress import clock, describe, ProgressDisplay
from jaxgrow.growth.progress import Progress


def _by_size(size, seconds, divisions=0):
    return Progress(divisions, size, 10.0, None, size / 10, 4e-4, seconds)


def _shown(states, **terminal):
    output = io.StringIO()
    with ProgressDisplay(Console(file=output, width=100, **terminal)) as display:
        for state in states:
            display(state)
    return output.getvalue()


def test_line_tells_divisions_size_residual_and_time_left():
    text = describe(_by_size(2.5, 3.0, 17), 75.0)
    assert text == "17 divisions, 2.5 of 10 mm, 25%, residual 4e-04, 1:15 left"


def test_line_tells_divisions_of_divisions():
    text = describe(Progress(3, 2.0, None, 12, 0.25, 4e-4, 1.0), None)
    assert text == "3 of 12 divisions, 2.0 mm, 25%, residual 4e-04"


@pytest.mark.parametrize(
    "seconds, text", [(0.0, "0:00"), (59.2, "1:00"), (125.0, "2:05"), (3725, "1:02:05")]
)
def test_clock_shows_minutes_and_hours(seconds, text):
    assert clock(seconds) == text


def test_without_a_terminal_lines_are_few():
    states = [_by_size(0.01 * n, 0.01 * n) for n in range(1, 1001)]
    lines = _shown(states).splitlines()
    assert lines[0] == "preparing the tissue"
    assert 8 <= len(lines) <= 13
    assert "10.0 of 10 mm" in lines[-1]
    assert "\x1b" not in "".join(lines)


def test_without_a_terminal_a_slow_growth_is_heard_of():
    states = [_by_size(0.001 * n, 31.0 * n) for n in range(1, 4)]
    assert len(_shown(states).splitlines()) == 4


def test_terminal_gets_a_live_bar():
    output = _shown([_by_size(5.0, 1.0)], force_terminal=True)
    assert "\x1b" in output
    assert "5.0 of 10 mm" in output


@pytest.mark.parametrize("exponent", [1.0, 2.0, 3.0])
def test_time_left_is_right_for_a_power_law(exponent):
    # All of the way takes 10^exponent, and half of it has been gone.
    states = [_by_size(0.05 * n, 1000 * (0.05 * n) ** exponent) for n in range(101)]
    left = 1000 * (10**exponent - 5**exponent)
    lines = _shown(states).splitlines()
    assert lines[-1].endswith(f"{clock(left)} left")


def test_size_zero_at_the_start_gives_no_time_left():
    lines = _shown([_by_size(0.0, 40.0 * n) for n in range(1, 9)]).splitlines()
    assert all("left" not in line for line in lines)
