"""Parts of vidphys that vidphys does not know: what a stranger's package looks like."""
