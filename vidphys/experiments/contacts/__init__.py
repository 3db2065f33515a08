"""Disks that touch: softly, stiffly, or without any give."""
