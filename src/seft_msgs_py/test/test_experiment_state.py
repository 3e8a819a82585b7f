"""The values of experiment/state: what is written is read again, and nothing else."""

import sys
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.experiment_state import ExperimentState, decode_state, encode_state
from seft_msgs_py.wire.messages import Status, decode_status, encode_status
from seft_msgs_py.wire.outcome import State

WHOLE = st.sampled_from([0, 2**63 - 1]) | st.integers(0, 2**63 - 1)
SECONDS = st.sampled_from([5e-324, 0.5, sys.float_info.max]) | st.floats(0.0, allow_infinity=False)
NAMES = st.lists(st.from_regex(r"[a-z_]+(/[a-z_]+)?", fullmatch=True)).map(tuple)
BY_TYPE = {
    State: st.sampled_from(State),
    str: st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0")),
    int | None: st.none() | WHOLE,
    float: SECONDS,
    float | None: st.none() | SECONDS,
    tuple[str, ...] | None: st.none() | NAMES,
}
BY_KEY = {one.name: BY_TYPE[one.type] for one in fields(ExperimentState)}


@given(st.builds(ExperimentState, **BY_KEY))
def test_each_value_is_read_as_it_was_written(state):
    assert decode_state(encode_state(state)) == state


def test_what_a_reader_of_the_wire_sees():
    state = ExperimentState(State.TRIPPED, "force", 9, 7, 0.014, silent=(), rehearse=2.5)
    status = decode_status(encode_state(state))
    assert (status.name, status.level, status.message) == ("experiment", 2, "tripped")
    assert status.values == {
        **{"detail": "force", "steps": "9", "step": "7", "time_s": "0.014"},
        **{"silent": "", "rehearse": "2.5"},
    }
    more = {**status.values, "new": "x"}
    assert decode_state(encode_status(Status("experiment", 2, "tripped", values=more))) == state


@pytest.mark.parametrize("key", ["steps", "step", "start_ns"])
@pytest.mark.parametrize("text", ["", "x", "-3", "1.0", " 1", "1_0", "²", str(2**63), "9" * 5000])
def test_what_is_no_whole_number_is_refused_with_its_key(key, text):
    with pytest.raises(WireError, match=rf"experiment/state: {key} is '.*', but must be a whole"):
        decode_state(encode_status(Status("experiment", 0, "running", values={key: text})))


@pytest.mark.parametrize("key", ["time_s", "rehearse", "zeroing"])
@pytest.mark.parametrize("text", ["", "x", "-1e-300", "nan", "inf", "1e999"])
def test_what_is_no_time_is_refused_with_its_key(key, text):
    with pytest.raises(WireError, match=rf"experiment/state: {key} is '{text}', but must be a fin"):
        decode_state(encode_status(Status("experiment", 0, "idle", values={key: text})))


def test_an_unknown_state_is_refused():
    with pytest.raises(WireError, match="state is 'halted', but must be one of idle, ready, run"):
        decode_state(encode_status(Status("experiment", 0, "halted")))


@pytest.mark.parametrize(
    "values",
    [
        *({"steps": wrong} for wrong in (-1, 2**63, 1.0, "1", True)),
        *({"zeroing": wrong} for wrong in (-0.5, float("nan"), float("inf"), None, "1")),
        *({"silent": wrong} for wrong in ("rig", ("a rig",), ("",), (1,), 3)),
        *({"detail": wrong} for wrong in (None, 3, "\0")),
    ],
)
def test_what_could_not_be_read_is_not_written(values):
    with pytest.raises(WireError, match=next(iter(values))):
        encode_state(ExperimentState(State.IDLE, **values))


def test_rigs_start_together_if_their_clocks_agree():
    now = 7 * 10**18
    soon = ExperimentState(State.RUNNING, start_ns=now + 10**9)
    assert soon.until_start(now) == 1.0
    assert ExperimentState(State.RUNNING).until_start(now) == 0.0
    with pytest.raises(InputError, match="set the clocks of all hosts by one"):
        soon.until_start(now - 3600 * 10**9)
