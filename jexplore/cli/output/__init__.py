"""What commands print and where they write."""
