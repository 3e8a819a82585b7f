"""All claims, in the order of the paper."""

from seft_ros.paper.claim import Claim
from seft_ros.paper.claims_delay import claims_compensation, claims_delay
from seft_ros.paper.claims_loop import claims_loop
from seft_ros.paper.claims_tests import claims_tests
from seft_ros.paper.findings import Findings


def judge(found: Findings) -> list[Claim]:
    """Judge every claim; none is left out for not agreeing."""
    return [
        *claims_loop(found),
        *claims_tests(found),
        *claims_delay(found),
        *claims_compensation(found),
    ]
