"""Where bytes come from and go to: UDP, TCP and serial links by the strings users know."""
