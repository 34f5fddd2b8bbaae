"""The interface of a real FR3, to which programs connect by libfranka: wire, motions, reflexes."""
