"""What a scan says about which cells."""
