"""The growth loop of the paper (§4): divide, adapt, fair, reset."""
