"""The Camera resource over OpenCV: USB cameras, video files, folders of images, network streams."""
