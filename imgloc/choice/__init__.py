"""Which of several maps is a scan from? Of hundreds, too, by an index of their folder."""
