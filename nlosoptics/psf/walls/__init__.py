"""Point spread functions of whole scenes and of wall materials."""
