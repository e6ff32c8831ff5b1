"""The Camera resource over OpenCV: USB cameras, network streams, programs, video files and folders."""
