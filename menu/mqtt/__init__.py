"""The menu by MQTT: for Home Assistant, and for programs that shoot and wait for a picture."""
