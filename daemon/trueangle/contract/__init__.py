"""What daemon and laboratory agree on: units, file formats, the model contract. numpy and stdlib only."""
