"""The table of all verdicts: words, colours, exit codes, kinds in JUnit."""

from typing import Final

from .verdict import Verdict

SUCCESS: Final = Verdict("success", "good", 0, "success", "holds", "Success: {detail}")
FAILURE: Final = Verdict(
    "failure, as expected", "good", 0, "success", "holds", "Failure, as expected ({why}): {detail}"
)
NO_CRITERIA: Final = Verdict(
    "no success criteria", "plain", 0, "success", "holds", "Done; the scenario has {detail}"
)
MISSED: Final = Verdict(
    "missed", "bad", 3, "missed", "missed", "Success criteria missed: {detail}",
    ("failure", "missed"),
)  # fmt: skip
UNEXPECTED: Final = Verdict(
    "unexpected success", "bad", 3, "unexpected", "missed",
    "Unexpected success: the scenario expects a failure ({why})", ("failure", "missed"),
)  # fmt: skip
NOT_MEASURED: Final = Verdict(
    "not measured", "bad", 3, "unmeasured", "failed",
    "No verdict, as not all criteria could be measured: {detail}", ("error", "not measured"),
)  # fmt: skip
_EARLY: Final = "No success, as the run ended early: {detail}"
ENDED: Final = Verdict(
    "ended early", "bad", 3, "failed", "failed", _EARLY, ("error", "ended early")
)
TIMEOUT: Final = Verdict("timeout", "bad", 3, "timeout", "failed", _EARLY, ("error", "ended early"))
STOPPED: Final = Verdict("stopped", "bad", 128, "failed", "failed", _EARLY, ("error", "stopped"))
FAILED: Final = Verdict("failed", "bad", 1, "failed", "failed", _EARLY, ("error", "failed"))
INCOMPLETE: Final = (ENDED, TIMEOUT, STOPPED, FAILED)
VERDICTS: Final = (SUCCESS, FAILURE, NO_CRITERIA, MISSED, UNEXPECTED, NOT_MEASURED, *INCOMPLETE)
