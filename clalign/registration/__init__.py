"""The source's connectivity laid on the target's surface, as a match says."""
