"""How good a recovery is: against a reference, or against what was hidden from it."""
