"""What several camera drivers share: USB, serial lines, device nodes, files of still cameras."""
