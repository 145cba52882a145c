"""Laws and estimators on plain arrays; knows no wheel."""
