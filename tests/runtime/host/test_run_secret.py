from __future__ import annotations

from datetime import datetime, timedelta, timezone

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.models import MAX_CERTIFICATES_S
from hierax.runtime.host.run_secret import end_of


def test_a_certificate_ends_after_its_time_or_never() -> None:
    assert end_of(None) is None
    lasts = timedelta(seconds=MAX_CERTIFICATES_S)
    before = datetime.now(timezone.utc)
    end = end_of(MAX_CERTIFICATES_S)
    assert end is not None
    assert before + lasts <= end <= datetime.now(timezone.utc) + lasts


@pytest.mark.parametrize("lifetime_s", [1e12, 1e300])
def test_no_certificate_ends_after_all_calendars(lifetime_s: float) -> None:
    with pytest.raises(HieraxError, match=r"a certificate cannot hold for .* s; expected an end before the year 10000"):
        end_of(lifetime_s)
