"""Commands that write, join and use Behavioral Trace Maps."""
