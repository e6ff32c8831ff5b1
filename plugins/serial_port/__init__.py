"""Any serial port as a communication resource."""
