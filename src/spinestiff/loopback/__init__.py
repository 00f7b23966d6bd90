"""What the pages that this machine serves to itself share: who may ask, how long for, and how the server runs."""
