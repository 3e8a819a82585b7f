import pytest
from seft_msgs_py.node.middleware import NETWORK, ONE_HOST, PROFILES, RANGE, prepare_middleware


@pytest.mark.parametrize(
    ("given", "profiles", "reach"),
    [
        ({}, str(NETWORK), None),
        ({RANGE: "SUBNET"}, str(NETWORK), "SUBNET"),
        ({RANGE: "LOCALHOST"}, str(ONE_HOST), "SYSTEM_DEFAULT"),
        ({PROFILES: "own.xml"}, "own.xml", None),
        ({PROFILES: "own.xml", RANGE: "LOCALHOST"}, "own.xml", "LOCALHOST"),
        ({RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "192.0.2.1"}, None, "LOCALHOST"),
        # inherited, and asked for once more
        ({PROFILES: str(ONE_HOST), RANGE: "LOCALHOST"}, str(ONE_HOST), "SYSTEM_DEFAULT"),
        ({PROFILES: str(ONE_HOST), RANGE: "SYSTEM_DEFAULT"}, str(ONE_HOST), "SYSTEM_DEFAULT"),
        ({PROFILES: str(NETWORK), RANGE: "LOCALHOST"}, str(ONE_HOST), "SYSTEM_DEFAULT"),
    ],
)
def test_what_the_environment_asks_for_is_what_fastdds_reads(monkeypatch, given, profiles, reach):
    environment = dict(given)
    monkeypatch.setattr("os.environ", environment)
    for _ in range(2):
        prepare_middleware()
        assert (environment.get(PROFILES), environment.get(RANGE)) == (profiles, reach)
