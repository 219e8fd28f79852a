"""Studies: designed experiments planned, run, judged and analysed; a folder holds all there is of one."""
