"""The weak momentum balance of a motion (Sec. III of the paper): test fields, windows, rows."""
