"""The experiment of the paper, run again: its table, its figures and its appendix."""
