"""The words for what becomes of a sample: OK, or why it has no force. The codes are those of the tick."""

OK = "ok"
WARMING_UP = "warming up"
NOT_FINITE = "position or current is not finite"
OUT_OF_ORDER = "stamp repeats or runs backwards"
OUTLIER = "position is an outlier"
UNBOUNDED = "force is not finite"
BEYOND_STROKE = "position is beyond the stroke"
RESTARTED = "started, or restarted after a gap or jump"
UNSETTLED = "settling after lost samples"

REASONS = (  # in the order of the codes in `ces_observer.tick.tracker`
    OK,
    WARMING_UP,
    NOT_FINITE,
    OUT_OF_ORDER,
    OUTLIER,
    UNBOUNDED,
    BEYOND_STROKE,
    RESTARTED,
    UNSETTLED,
)
