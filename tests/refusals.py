"""What tests of refusals need."""

from collections.abc import Callable
from typing import Any

import pytest

from panda_cosim import InputError


def refused(call: Callable[..., object], *arguments: Any, **options: Any) -> str:
    """Call what has to be refused; returns the message, which is one line."""
    with pytest.raises(InputError) as caught:
        call(*arguments, **options)
    assert str(caught.value).isprintable()
    return str(caught.value)
