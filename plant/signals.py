"""What the plant takes and gives."""

from ..assets.fields import layouts

INPUTS, OUTPUTS = layouts(__file__)
