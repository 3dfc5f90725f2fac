"""The certificate in two forms: a PDF for people and a digital calibration certificate for programs."""
