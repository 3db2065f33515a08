"""Speed against accuracy: measured on this machine, chosen from, and guarded."""
