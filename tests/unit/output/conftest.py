import resource
from contextlib import contextmanager

import pytest


@pytest.fixture
def full_disk():
    """Let no file grow beyond a size: what a full disk looks like to who writes."""

    @contextmanager
    def limit(nbytes):
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (nbytes, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limit
