"""A virtual Nikon CoolPix 990 on a serial line."""
