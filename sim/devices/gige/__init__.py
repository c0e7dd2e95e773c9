"""A virtual GigE Vision camera: control protocol, streaming protocol and GenICam description."""
