## usage: value = eal_call (robot, resource, method, ...)
##
## Call a method of a robot's resource and return its answer:
##
##   eal_call ("evbot", "Base", "send_cmd", "f0.3");
##   pose = eal_call ("evbot", "Pose", "get_value");
##
## The first call starts a program that keeps the connection to the fleet until Octave ends.
function value = eal_call (robot, resource, method, varargin)
  persistent to from pid;
  if (isempty (pid))
    [to, from, pid] = popen2 ("python3", {"-s", "/usr/lib/evbotos/octave_robot.pyc"});
  endif
  fputs (to, [jsonencode({robot, resource, method, varargin}) "\n"]);
  fflush (to);
  line = "";
  while (isempty (line) || line(end) != "\n")
    part = fgets (from);
    if (ischar (part))
      line = [line part];
    elseif (waitpid (pid, WNOHANG ()) == 0)  # it computes
      pause (0.002);
      fclear (from);
    else
      pid = [];
      error ("eal_call: the connection to the fleet has ended");
    endif
  endwhile
  answer = jsondecode (line);
  if (isfield (answer, "error"))
    error ("eal_call: %s", answer.error);
  endif
  value = answer.value;
endfunction
