# What stands for the words of an example here: fixtures/court-mini has 6 frames, 0 to 5, and cameras 0, 3, 7,
# 12, 15, 19, 23 and 27; trainings are short and the pictures of an orbit small.
s/--test-cams 0,10,15,30/--test-cams 0,15/g
s/--iterations [0-9]*/--iterations 20/g
s/--refine [0-9][0-9]*/--refine 10/g
s/--hash-log2 [0-9]*/--hash-log2 12/g
s/--batch [0-9]*/--batch 2/g
s/--eval-every [0-9]*/--eval-every 10/g
s/--range 0:150:10/--range 0:6:2/g
s/--range 60:80/--range 2:4/g
s/--range 12:13/--range 2:3/g
s/ --map-by ppr:1:node//g
s/mpirun -n [0-9]*/mpirun -n 2/g
s/--path orbit/--path orbit --size 160x90/g
