"""How an experiment with numbers at their ends may end."""

EXACT, BOUNDED, UNFIT, REFUSED = "exact", "bounded", "does not fit", "refused"
DIVERGES, NOT_FINITE = "diverges", "not finite"  # which the code as it is may not
Judged = tuple[str, float, str]  # end, what was measured, the message of a refusal or what bounds
