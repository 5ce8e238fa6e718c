"""Where the gap between simulator and joint lies, which effect causes it, how far adding it shrinks the gap."""
